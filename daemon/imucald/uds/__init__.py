"""Diagnostics on the bus: a server of unified diagnostic services (ISO 14229-1).

Bytes of a request in, bytes of a response out. No I/O, no clock of its own, no transport: those are
`service.diagnostics`.
"""
