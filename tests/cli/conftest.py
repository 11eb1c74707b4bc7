import pyarrow as pa
import pyarrow.parquet as pq
import pytest


@pytest.fixture(scope="session")
def rewritten():
    """Return a function that writes a table to a path with other units."""

    def write(table, path, **units):
        fields = [
            pa.field(f.name, f.type, metadata={"unit": units.get(f.name, f.metadata[b"unit"].decode())})
            for f in table.schema
        ]
        pq.write_table(pa.table(table.columns, schema=pa.schema(fields)), path)

    return write
