"""A phone's socket with limits: bounded messages in, bounded waits out."""

from __future__ import annotations

import asyncio

from pydantic import BaseModel
from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from server.protocol.close_codes import CloseCode
from server.protocol.error_codes import ErrorCode
from server.protocol.frames import HEADER
from server.protocol.messages import ErrorMessage

_CLOSE_TIMEOUT_S = 1.0


class ConnectionGone(Exception):  # noqa: N818 - the phone's doing, no error of ours
    """The phone is no longer there."""


class EndConnection(Exception):  # noqa: N818 - a decision, not a failure
    """The connection has to be closed with an error message.

    Attributes:
        close: the close code.
        code, detail: of the error message.
    """

    def __init__(self, close: CloseCode, code: ErrorCode, detail: str, sequence: int | None = None) -> None:
        super().__init__(detail)
        self.close = close
        self.code = code
        self.detail = detail
        self.sequence = sequence


class PhoneChannel:
    """Sends and receives on a socket.

    Args:
        max_frame_bytes: payload of a binary message.
        max_message_bytes: of a text message.
        send_timeout_s: for the phone's network to take a message.
    """

    def __init__(
        self, websocket: WebSocket, max_frame_bytes: int, max_message_bytes: int, send_timeout_s: float
    ) -> None:
        self._websocket = websocket
        self._max_binary = max_frame_bytes + HEADER.size
        self._max_text = max_message_bytes
        self._send_timeout_s = send_timeout_s
        self._sending = asyncio.Lock()

    async def receive(self, timeout_s: float) -> str | bytes:
        """The next message: text or binary.

        Raises:
            TimeoutError: none came.
            ConnectionGone: none will come.
            EndConnection: it is too large.
        """
        message = await asyncio.wait_for(self._websocket.receive(), timeout_s)
        if message["type"] != "websocket.receive":
            raise ConnectionGone
        binary: bytes | None = message.get("bytes")
        if binary is not None:
            if len(binary) > self._max_binary:
                raise _too_large(f"a binary message may have {self._max_binary} bytes")
            return binary
        text: str = message.get("text") or ""
        if len(text.encode()) > self._max_text:
            raise _too_large(f"a text message may have {self._max_text} bytes")
        return text

    async def send(self, message: BaseModel) -> None:
        """Send a message.

        Raises:
            ConnectionGone: there is nobody to send to.
            EndConnection: the phone does not read.
        """
        text = message.model_dump_json()
        try:
            async with self._sending:
                await asyncio.wait_for(self._websocket.send_text(text), self._send_timeout_s)
        except TimeoutError:
            raise EndConnection(
                CloseCode.SLOW_CLIENT, ErrorCode.SLOW_CLIENT, "the client does not read"
            ) from None
        except (WebSocketDisconnect, RuntimeError):
            raise ConnectionGone from None

    async def close(self, code: CloseCode, last: BaseModel | None = None) -> None:
        """Send a last message if it can be sent, and close. Never raises, never takes long."""
        if self._websocket.client_state is not WebSocketState.CONNECTED:
            return
        try:
            if last is not None and code is not CloseCode.SLOW_CLIENT:
                await asyncio.wait_for(self._websocket.send_text(last.model_dump_json()), _CLOSE_TIMEOUT_S)
            await asyncio.wait_for(self._websocket.close(int(code), code.name.lower()), _CLOSE_TIMEOUT_S)
        except (TimeoutError, WebSocketDisconnect, RuntimeError):
            return


def error_message(end: EndConnection) -> ErrorMessage:
    """The last message before a close."""
    return ErrorMessage(code=end.code, detail=end.detail, sequence=end.sequence, fatal=True)


def _too_large(detail: str) -> EndConnection:
    return EndConnection(CloseCode.TOO_LARGE, ErrorCode.TOO_LARGE, detail)
