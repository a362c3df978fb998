"""Addresses that a learner listens on and workers connect to, as users write them."""

import ipaddress
import re

from dppo.errors import UsageError

_TCP = re.compile(r"tcp/(\[[^\s\]]+\]|[^\s/\[\]:#]+):(\d{1,5})(#.*)?")
_SOCKET = re.compile(r"unixsock-stream/.+")


def check_address(flag: str, address: str) -> None:
    """Refuse what is no address, before Zenoh retries it for ever.

    Zenoh knows more protocols. UDP loses messages, TLS and QUIC want certificates, which there
    are no settings for yet, and nothing here was tried over them.

    Raises:
        UsageError: the address is malformed, or of another protocol.
    """
    match = _TCP.fullmatch(address)
    if _SOCKET.fullmatch(address) or (match is not None and 0 < int(match[2]) <= 65535):
        return
    raise UsageError(
        f"{flag} is {address!r}, expected an address such as tcp/learner:7447 or "
        "tcp/127.0.0.1:7447"
    )


def is_loopback(address: str) -> bool:
    """Only programs on this machine reach it; of an address that `check_address` lets through."""
    match = _TCP.fullmatch(address)
    if match is None:
        return True  # a socket in the file system
    host = match[1].strip("[]")
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
