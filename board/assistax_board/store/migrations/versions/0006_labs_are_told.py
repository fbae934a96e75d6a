"""Labs are told by a webhook when a submission has ended."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"


def upgrade() -> None:
    """Go to this version."""
    op.add_column("submitters", sa.Column("webhook", sa.String(length=500), nullable=True))
    op.add_column("submissions", sa.Column("told_at", sa.Float(), nullable=True))


def downgrade() -> None:
    """Go back to the version before."""
    with op.batch_alter_table("submissions") as batch_op:
        batch_op.drop_column("told_at")
    with op.batch_alter_table("submitters") as batch_op:
        batch_op.drop_column("webhook")
