"""The league: any of its rows from nothing, and the page's tables and figures."""
