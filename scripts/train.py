"""The same as `deep-curiosity train`."""

import sys

from deep_curiosity.cli import main

if __name__ == "__main__":
    sys.exit(main(["train", *sys.argv[1:]]))
