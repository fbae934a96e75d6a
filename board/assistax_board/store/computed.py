"""What took long to compute and follows from other tables: computed by one server, read by all.

Each value has a name, and a key of all that it follows from. Only the newest is kept.
"""

import sqlalchemy as sa

from assistax_board.store import schema
from assistax_board.store.database import Database, insert_once
from assistax_board.store.schema import COMPUTED


def kept(database: Database, name: str) -> str | None:
    """Return the value of a name, if there is any."""
    query = sa.select(COMPUTED.value).where(COMPUTED.name == name)
    with database.read() as connection:
        return connection.execute(query).scalar()


def keep(database: Database, name: str, value: str) -> None:
    """Keep a value in place of the one before it."""
    with database.write() as connection:
        if not insert_once(connection, schema.computed, {"name": name, "value": value}):
            again = sa.update(schema.computed).where(COMPUTED.name == name)
            connection.execute(again.values(value=value))
