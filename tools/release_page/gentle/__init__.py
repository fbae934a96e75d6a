"""The questions of releases of gentle tasks: preferences, splits, methods."""

from tools.release_page.gentle.data import read_results as read_results
from tools.release_page.gentle.page import figures as figures
from tools.release_page.gentle.page import make_page as make_page
from tools.release_page.gentle.page import tables as tables
