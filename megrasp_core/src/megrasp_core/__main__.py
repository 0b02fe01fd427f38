"""`python -m megrasp_core`: the `megrasp` command, for launchers that start Python modules."""

import sys

from megrasp_core.cli import main

if __name__ == "__main__":
    sys.exit(main())
