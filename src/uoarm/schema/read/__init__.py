"""Reading schemas: drafts, references and keywords, into nodes that are numbered by content."""

from uoarm.schema.read._document import Document, Pool
from uoarm.schema.read._node import Node

__all__ = ["Document", "Node", "Pool"]
