"""For the process that begins those in which robots are looked at: all of them come after requests.

It imports this before anything else; nobody else does.
"""

import os

os.nice(10)
