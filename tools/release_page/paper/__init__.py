"""The questions of releases of the paper's tasks: its tables, figures and claims."""

from tools.release_page.paper.data import read_results as read_results
from tools.release_page.paper.figures import figures as figures
from tools.release_page.paper.page import make_page as make_page
from tools.release_page.paper.page import tables as tables
