"""Make the page of a release's results from small tables; a folder for each kind of release."""
