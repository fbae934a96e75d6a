"""Runs the migrations; alembic calls this file."""

import sqlalchemy as sa
from alembic import context

from assistax_zoo.service.schema import METADATA

engine = sa.create_engine(context.config.attributes["url"], poolclass=sa.pool.NullPool)
with engine.connect() as connection:
    # SQLite changes tables by copying them, which alembic calls a batch.
    context.configure(connection, target_metadata=METADATA, render_as_batch=True)
    with context.begin_transaction():
        context.run_migrations()
