"""Kinds of partners: teams of the registry, persons, and those of installed packages."""
