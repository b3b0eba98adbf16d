"""Who may do what: credentials, roles, the policy that grants them, the audit log."""

from uoarm.server.access._admission import (
    Admission,
    Credentials,
    RefusedError,
    RequestHead,
    WrongTokenError,
    WrongTokens,
    read_head,
)
from uoarm.server.access._approvals import (
    Approval,
    ApprovalEnvelope,
    ApprovalError,
    ApprovalFoundation,
    ApprovalPhase,
    ApprovalRequest,
    Approvals,
    Supervision,
)
from uoarm.server.access._role import (
    AccessRole,
    Audit,
    AuditFile,
    DeniedError,
    Grant,
    Operation,
    hash_token,
    make_token,
)
from uoarm.server.access._role_view import RoleView, RoleViews

__all__ = [
    "AccessRole",
    "Admission",
    "Approval",
    "ApprovalEnvelope",
    "ApprovalError",
    "ApprovalFoundation",
    "ApprovalPhase",
    "ApprovalRequest",
    "Approvals",
    "Audit",
    "AuditFile",
    "Credentials",
    "DeniedError",
    "Grant",
    "Operation",
    "RefusedError",
    "RequestHead",
    "RoleView",
    "RoleViews",
    "Supervision",
    "WrongTokenError",
    "WrongTokens",
    "hash_token",
    "make_token",
    "read_head",
]
