"""`python -m mapf_pz` is the command `mapf-pz`."""

import sys

from mapf_pz.commands.main import main

if __name__ == "__main__":
    sys.exit(main())
