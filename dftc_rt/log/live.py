"""What is logged, to viewers on this machine while the run lasts: Foxglove, Lichtblick.

The server is the SDK's own, in the recorder's process, and speaks ``foxglove.sdk.v1`` over a
WebSocket of 127.0.0.1. It has no capability but to stream: a viewer can neither publish nor
call nor set anything. One that does not keep up loses its oldest messages; nobody waits for it.
"""

from __future__ import annotations

import socket
from typing import Final

import foxglove
from foxglove.websocket import ChannelView, Client, ServerListener

from dftc_rt.errors import InputError

HOST: Final = "127.0.0.1"
PORT: Final = 8765
"""Where viewers look first."""

MARK: Final = {"dftc_rt": "live"}
"""Metadata of a channel that goes to viewers and not to the file."""


def check_port(port: int, option: str) -> None:
    """Refuse a port that the server could not open.

    Args:
        port: Of this machine.
        option: What the user named it with.

    Raises:
        InputError: It is no port, is taken, or is not for this user.
    """
    if not 0 < port < 65536:
        raise InputError(option, str(port), "a port, 1 to 65535")
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as trial:
        trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as the server does
        try:
            trial.bind((HOST, port))
            trial.listen(1)
        except OSError as error:
            what = f"port {port} of {HOST} cannot be opened: {error.strerror}"
            raise InputError(option, what, "a free port") from None


class LiveServer(ServerListener):
    """Streams the channels of a context.

    Attributes:
        subscribed: Somebody has begun to look at something since this was last set to False.
    """

    def __init__(self, context: foxglove.Context, port: int, name: str) -> None:
        """Open the port.

        Args:
            context: Whose channels.
            port: Of 127.0.0.1.
            name: What a viewer shows as its name.

        Raises:
            InputError: The port cannot be opened.
        """
        self.subscribed = False
        try:
            self._server = foxglove.start_server(
                name=name,
                host=HOST,
                port=port,
                context=context,
                server_listener=self,
            )
        except (OSError, RuntimeError) as error:
            raise InputError("live view", f"port {port} of {HOST}: {error}", "a free one") from None

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Note that there is somebody new, in a thread of the server."""
        self.subscribed = True

    def stop(self) -> None:
        """Close the port."""
        self._server.stop()


def for_file(channel: foxglove.ChannelDescriptor) -> bool:
    """Whether a channel goes to the file."""
    return dict(channel.metadata) != MARK
