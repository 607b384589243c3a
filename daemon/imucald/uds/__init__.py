"""Unified diagnostic services (ISO 14229-1): bytes of a request in, bytes of a response out.

No I/O and no clock of its own. `isotp_channel` carries requests and responses in CAN frames;
`service.uds_on_bus` puts the server on the running daemon.
"""
