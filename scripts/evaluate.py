"""The same as `deep-curiosity evaluate`."""

import sys

from deep_curiosity.cli import main

if __name__ == "__main__":
    sys.exit(main(["evaluate", *sys.argv[1:]]))
