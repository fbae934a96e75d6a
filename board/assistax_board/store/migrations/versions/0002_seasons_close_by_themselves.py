"""Seasons have a closing date, and labs choose what plays their panel B."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"


def upgrade() -> None:
    """Go to this version."""
    op.add_column("seasons", sa.Column("closes_at", sa.Float(), nullable=True))
    op.add_column("submissions", sa.Column("entered_at", sa.Float(), nullable=True))


def downgrade() -> None:
    """Go back to the version before."""
    with op.batch_alter_table("submissions") as batch_op:
        batch_op.drop_column("entered_at")
    with op.batch_alter_table("seasons") as batch_op:
        batch_op.drop_column("closes_at")
