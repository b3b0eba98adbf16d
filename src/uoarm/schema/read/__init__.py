"""Reading schemas: drafts, references and keywords, into nodes that are numbered by content."""

from uoarm.schema.read._document import Pool, SchemaDocument
from uoarm.schema.read._node import LISTS, MAPS, SINGLES, SchemaNode

__all__ = ["LISTS", "MAPS", "SINGLES", "Pool", "SchemaDocument", "SchemaNode"]
