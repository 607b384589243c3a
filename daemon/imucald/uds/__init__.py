"""Unified diagnostic services (ISO 14229-1): convert request bytes to response bytes.

The server has no I/O and no clock. `isotp_channel` transports requests and responses in CAN frames.
`service.uds_on_bus` connects the server to the running daemon.
"""
