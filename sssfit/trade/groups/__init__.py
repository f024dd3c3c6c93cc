"""One file a group of approximations: what is chosen, what it loses and against what that is measured."""
