"""Reading schemas: drafts, references and keywords, into nodes that are numbered by content."""

from uoarm.schema.read._document import Pool, SchemaDocument
from uoarm.schema.read._node import SchemaNode

__all__ = ["Pool", "SchemaDocument", "SchemaNode"]
