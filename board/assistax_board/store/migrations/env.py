"""Runs the migrations; alembic calls this file."""

import sqlalchemy as sa
from alembic import context
from sqlalchemy import event

from assistax_board.store.schema import METADATA

engine = sa.create_engine(context.config.attributes["url"], poolclass=sa.pool.NullPool)
is_sqlite = engine.dialect.name == "sqlite"
if is_sqlite:  # its driver would commit every table on its own: a kill would leave half a schema

    @event.listens_for(engine, "connect")
    def _connect(connection, _):
        connection.isolation_level = None

    @event.listens_for(engine, "begin")
    def _begin(connection):
        connection.exec_driver_sql("BEGIN IMMEDIATE")


with engine.connect() as connection:
    # SQLite changes tables by copying them, which alembic calls a batch.
    context.configure(
        connection, target_metadata=METADATA, render_as_batch=True, transactional_ddl=True
    )
    with context.begin_transaction():
        context.run_migrations()
