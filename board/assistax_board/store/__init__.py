"""Storage of the board: the database, artefacts, the ledger, receipts, backups."""
