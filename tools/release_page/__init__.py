"""Pages of a release's results, made from small tables; a folder for each kind of release."""
