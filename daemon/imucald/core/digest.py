"""SHA-256 from the interpreter's own module.

`hashlib` would load OpenSSL: 3.6 MiB of the 50 MiB that a daemon may take, and 3 ms.
"""

from __future__ import annotations

try:
    from _sha256 import sha256  # type: ignore[import-not-found,unused-ignore]
except ImportError:  # its name from Python 3.12 on
    try:
        from _sha2 import sha256  # type: ignore[import-not-found,unused-ignore]
    except ImportError:
        from hashlib import sha256

__all__ = ["sha256"]
