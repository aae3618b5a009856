"""`python -m deep_curiosity.integrations.check` is `deep-curiosity check`."""

import sys

if __name__ == "__main__":
    # here, since integrations know nothing of the layers above
    from deep_curiosity.cli import main

    sys.exit(main(["check", *sys.argv[1:]]))
