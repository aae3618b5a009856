"""The same as `deep-curiosity tune`."""

import sys

from deep_curiosity.cli import main

if __name__ == "__main__":
    sys.exit(main(["tune", *sys.argv[1:]]))
