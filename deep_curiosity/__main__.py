"""`python -m deep_curiosity` is `deep-curiosity`."""

import sys

from deep_curiosity.cli import main

if __name__ == "__main__":
    sys.exit(main())
