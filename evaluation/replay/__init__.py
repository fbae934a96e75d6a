"""Playing a saved result again, and deriving its figures again."""
