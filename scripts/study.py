"""The same as `deep-curiosity study`."""

import sys

from deep_curiosity.cli import main

if __name__ == "__main__":
    sys.exit(main(["study", *sys.argv[1:]]))
