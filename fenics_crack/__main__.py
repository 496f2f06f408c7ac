"""``python -m fenics_crack`` is the program ``fenics-crack``."""

import sys

from fenics_crack.cli.command_line import main

sys.exit(main())
