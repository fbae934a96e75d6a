"""Run the command line as `python -m assistax_zoo`."""

import sys

from assistax_zoo.shadows import refuse_shadows

if __name__ == "__main__":
    try:
        refuse_shadows()  # `-m` puts the working folder first on the module path
    except ImportError as error:
        sys.exit(f"error: {error}")
    from assistax_zoo.main import run

    sys.exit(run())
