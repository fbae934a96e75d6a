"""A season says of what kind its hidden partners are, and a robot is warned of other versions."""

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0004"


def upgrade() -> None:
    """Go to this version."""
    op.add_column("seasons", sa.Column("hidden", sa.JSON(), nullable=True))
    op.add_column("submissions", sa.Column("warning", sa.Text(), nullable=True))


def downgrade() -> None:
    """Go back to the version before."""
    with op.batch_alter_table("submissions") as batch_op:
        batch_op.drop_column("warning")
    with op.batch_alter_table("seasons") as batch_op:
        batch_op.drop_column("hidden")
