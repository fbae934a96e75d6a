"""Run the command line as `python -m assistax_zoo`."""

import sys

from assistax_zoo.main import run

sys.exit(run())
