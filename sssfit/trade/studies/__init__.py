"""What is asked beyond one group of choices: what a frame costs, and what it needs."""
