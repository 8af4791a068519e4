"""A viser server on loopback that answers nobody without the run's token.

viser has no check of its own, so its handshake is wrapped: every request, of the page and of
its websocket, has the token as its path, and anything else is answered with 403. The page's
content security policy has the browser itself refuse requests to anywhere else.
"""

from __future__ import annotations

import contextlib
import hmac
import io
import secrets
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from typing import Any, Final
from urllib.parse import parse_qs, urlsplit

from dftc_rt.errors import EnvironmentLacksError

_LOOPBACK: Final = "127.0.0.1"
_TOKEN_BYTES: Final = 32
_REFUSED: Final = b"This page needs its token: open the whole address that dftc printed.\n"


def check_installed() -> None:
    """Look whether there is a server at all, without loading it.

    Raises:
        EnvironmentLacksError: viser is not installed.
    """
    if find_spec("viser") is None:
        raise EnvironmentLacksError("viser is not installed", "pip install 'dftc_rt[view]'")


class PageServer:
    """The page's server; runs in threads of its own.

    Attributes:
        viser: The ``viser.ViserServer``: ``scene`` and ``gui`` are its parts.
        url: Address with the token.
    """

    def __init__(self, label: str) -> None:
        """Start to serve on a free port of 127.0.0.1.

        Args:
            label: Title of the panel.

        Raises:
            EnvironmentLacksError: viser is not installed, or another version than can be guarded.
        """
        check_installed()
        import viser
        import websockets.asyncio.server as handshake

        class Server(viser.ViserServer):
            def request_share_url(self, verbose: bool = True) -> str | None:
                return None  # viser would open a tunnel to a server of its makers

        self._token = secrets.token_urlsafe(_TOKEN_BYTES)
        guarded: list[Any] = []
        serve: Any = handshake.serve

        def serve_guarded(*args: Any, process_request: Any, **options: Any) -> Any:
            guarded.append(process_request)
            return serve(*args, process_request=self._guard(process_request), **options)

        handshake.serve = serve_guarded  # type: ignore[assignment,misc]
        try:
            with _silent():
                self.viser: Any = Server(host=_LOOPBACK, port=0, label=label, verbose=False)
        finally:
            handshake.serve = serve  # type: ignore[misc]
        if not guarded:
            self.close()
            raise EnvironmentLacksError(
                "this version of viser cannot be guarded", "pip install 'dftc_rt[view]'"
            )
        self._authority = f"{_LOOPBACK}:{self.viser.get_port()}"
        self.url = f"http://{self._authority}/?token={self._token}"
        self.viser.gui.configure_theme(show_logo=False, show_share_button=False)

    def close(self) -> None:
        """Stop serving."""
        with _silent():
            self.viser.stop()

    @property
    def watched(self) -> bool:
        """Whether any page is open."""
        return bool(self.viser.get_clients())

    def _guard(self, process: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        """Wrap what answers requests, of HTTP and of the websocket's handshake."""
        from websockets.datastructures import Headers
        from websockets.http11 import Response

        def answer(status: int, phrase: str, body: bytes = b"", **headers: str) -> Any:
            found = Headers(**headers)
            found["Content-Length"] = str(len(body))
            found["Content-Type"] = "text/plain; charset=utf-8"
            return Response(status, phrase, found, body)

        def guard(connection: Any, request: Any) -> Any:
            asked = urlsplit(request.path)
            first, _, rest = asked.path.lstrip("/").partition("/")
            if self._is_token(first):
                request.path = f"/{rest}"
                response = process(connection, request)
                if response is not None:
                    self._confine(response.headers)
                return response
            given = parse_qs(asked.query).get("token", [])
            if asked.path == "/" and any(map(self._is_token, given)):
                # Into the path, from where the page's own script takes it to the websocket.
                return answer(303, "See Other", Location=f"/{self._token}")
            return answer(403, "Forbidden", _REFUSED)

        return guard

    def _is_token(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(errors="replace"), self._token.encode())

    def _confine(self, headers: Any) -> None:
        """Have the browser ask nobody else, tell nobody the address, and frame the page nowhere."""
        headers["Content-Security-Policy"] = (
            "default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:; "
            f"connect-src 'self' ws://{self._authority} data: blob:; "
            "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        )
        headers["Referrer-Policy"] = "no-referrer"
        headers["Cache-Control"] = "no-store"


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Keep viser, which tells of its start and its end there, off standard output."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield
