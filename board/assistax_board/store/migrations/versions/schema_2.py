"""Declared entries."""

import sqlalchemy as sa
from alembic import op

revision = "schema_2"
down_revision = "schema_1"


def upgrade() -> None:
    """Go to this version: what was handed in before is a single robot."""
    op.create_table(
        "entries",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("submitter", sa.String(length=32), nullable=False),
        sa.Column("request", sa.String(length=64), nullable=False),
        sa.Column("task", sa.String(length=40), nullable=False),
        sa.Column("method", sa.String(length=80), nullable=False),
        sa.Column("season", sa.String(length=32), nullable=True),
        sa.Column("files", sa.JSON(), nullable=False),
        sa.Column("card", sa.JSON(), nullable=False),
        sa.Column("created_at", sa.Float(), nullable=False),
        sa.Column("frozen_at", sa.Float(), nullable=True),
        sa.ForeignKeyConstraint(["season"], ["seasons.id"], name=op.f("fk_entries_season")),
        sa.ForeignKeyConstraint(
            ["submitter"], ["submitters.id"], name=op.f("fk_entries_submitter")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_entries")),
        sa.UniqueConstraint("submitter", "request", name=op.f("uq_entries_submitter")),
    )
    # Alembic would copy the table to add a key, which SQLite refuses while others point to it.
    op.execute(
        "ALTER TABLE submissions ADD COLUMN entry VARCHAR(32) "
        "CONSTRAINT fk_submissions_entry REFERENCES entries (id)"
    )
