"""What the board keeps: the database, artefacts, the ledger, receipts, backups."""
