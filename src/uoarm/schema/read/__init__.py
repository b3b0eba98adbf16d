"""Reading schemas: drafts, references and keywords, into nodes that are numbered by content."""

from uoarm.schema.read._document import Pool, SchemaDocument
from uoarm.schema.read._node import SchemaNode
from uoarm.schema.read._resources import NEWEST, REFERENCES, Dialect, dialect_of

__all__ = ["NEWEST", "REFERENCES", "Dialect", "Pool", "SchemaDocument", "SchemaNode", "dialect_of"]
