"""Who may do what: credentials, roles, the policy that grants them, the audit log."""

from uoarm.server.access._admission import Admission, Credentials, is_loopback
from uoarm.server.access._audit import Audit
from uoarm.server.access._policy import hash_token, make_token
from uoarm.server.access._request_head import RefusedError, RequestHead, WrongTokenError, read_head
from uoarm.server.access._role import DeniedError, Operation, Role
from uoarm.server.access._role_view import RoleView, RoleViews
from uoarm.server.access._wrong_tokens import WrongTokens

__all__ = [
    "Admission",
    "Audit",
    "Credentials",
    "DeniedError",
    "Operation",
    "RefusedError",
    "RequestHead",
    "Role",
    "RoleView",
    "RoleViews",
    "WrongTokenError",
    "WrongTokens",
    "hash_token",
    "is_loopback",
    "make_token",
    "read_head",
]
