"""Speed on this machine: `python -m benchmarks --help`. Not part of the installed packages."""
