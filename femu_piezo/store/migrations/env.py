"""What Alembic runs: the migrations on the connection of `femu_piezo.store.database`, in its transaction."""

from __future__ import annotations

from alembic import context

from femu_piezo.store.schema import VERSION_TABLE

context.configure(
    connection=context.config.attributes["connection"], version_table=VERSION_TABLE, transactional_ddl=True
)
context.run_migrations()
