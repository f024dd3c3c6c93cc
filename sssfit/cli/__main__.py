"""`python -m sssfit.cli` is `sssfit`."""

import sys

from sssfit.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
