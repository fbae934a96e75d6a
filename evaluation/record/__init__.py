"""Files of a finished evaluation: tables, the manifest, and the sources of both."""
