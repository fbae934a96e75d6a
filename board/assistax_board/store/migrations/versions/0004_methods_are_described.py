"""A submission describes its method: a text, a link, a citation."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
NAMES = ("about", "link", "citation")


def upgrade() -> None:
    """Go to this version."""
    for name in NAMES:
        op.add_column("submissions", sa.Column(name, sa.Text(), nullable=True))


def downgrade() -> None:
    """Go back to the version before."""
    with op.batch_alter_table("submissions") as batch_op:
        for name in NAMES:
            batch_op.drop_column(name)
