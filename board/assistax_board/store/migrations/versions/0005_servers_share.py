"""Several servers share connections of live robots, rates, and what took long to compute."""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"


def upgrade() -> None:
    """Go to this version."""
    op.create_table(
        "seats",
        sa.Column("submission", sa.String(length=32), nullable=False),
        sa.Column("owner", sa.String(length=32), nullable=False),
        sa.Column("seat", sa.String(length=32), nullable=True),
        *(sa.Column(name, sa.Float(), nullable=False) for name in ("until", "seen_at", "thought")),
        sa.Column("batch", sa.Text(), nullable=True),
        sa.Column("step", sa.Integer(), nullable=True),
        *(sa.Column(name, sa.LargeBinary(), nullable=True) for name in ("question", "answer")),
        sa.ForeignKeyConstraint(
            ["submission"], ["submissions.id"], name=op.f("fk_seats_submission")
        ),
        sa.PrimaryKeyConstraint("submission", name=op.f("pk_seats")),
    )
    op.create_index(op.f("ix_seats_seat"), "seats", ["seat"])
    op.create_table(
        "rates",
        sa.Column("name", sa.String(length=120), nullable=False),
        sa.Column("count", sa.Integer(), nullable=False),
        *(sa.Column(name, sa.Float(), nullable=False) for name in ("changed_at", "expires_at")),
        sa.PrimaryKeyConstraint("name", name=op.f("pk_rates")),
    )
    op.create_table(
        "computed",
        sa.Column("name", sa.String(length=160), nullable=False),
        sa.Column("value", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("name", name=op.f("pk_computed")),
    )


def downgrade() -> None:
    """Go back to the version before."""
    for name in ("computed", "rates", "seats"):
        op.drop_table(name)
