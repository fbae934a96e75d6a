"""Gates of persons: do robots adapt to them, and is there care in what pays?"""
