"""Make the results page of the release of gentle tasks from small tables."""
