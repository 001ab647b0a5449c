"""``python -m hybrid.cli``: the same as the command ``hybrid``, for programs such as torchrun that start modules."""

import sys

from hybrid.cli import main

if __name__ == "__main__":
    sys.exit(main())
