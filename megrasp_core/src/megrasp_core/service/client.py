"""Client of the resident planner, with nothing but the standard library and numpy."""

from __future__ import annotations

import io
import json
import urllib.error
import urllib.parse
import urllib.request
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

__all__ = ["PlannerClient", "PlannerError"]


class PlannerError(Exception):
    """The planner refused or failed.

    code: as in docs/ros.md, 0 where nobody answered. The text says what was given, what was
    expected and what to do.
    """

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


class PlannerClient:
    """Asks a planner that `megrasp serve` runs.

    The gripper stays until another one is set:

        planner = PlannerClient("http://127.0.0.1:8741")
        planner.set_gripper("franka_hand")
        answer = planner.synthesize(points, sensor=[0, 0, 0.8], num_grasps=5)
        best = answer["grasps"][0]["world_from_gripper"]
    """

    def __init__(
        self, address: str = "http://127.0.0.1:8741", token: str = "", timeout: float = 120.0
    ) -> None:
        """Take address and token that `megrasp serve` printed, and the longest wait (s)."""
        self._address, self._token, self._timeout = address.rstrip("/"), token, timeout

    def synthesize(
        self,
        points: ArrayLike,
        *,
        labels: ArrayLike | None = None,
        **options: Any,
    ) -> dict[str, Any]:
        """Ranked grasps, the content of grasps.json.

        Args:
            points: (N, 3) metres.
            labels: (N,) objects of a mask.
            options: of `SynthesisRequest`; arrays become lists.

        Raises:
            PlannerError: a bad request, a busy planner, or nobody there.
        """
        body = io.BytesIO()
        arrays: dict[str, np.ndarray] = {"points": np.asarray(points, dtype=np.float32)}
        if labels is not None:
            arrays["labels"] = np.asarray(labels, dtype=np.int32)
        np.savez(body, **arrays)  # type: ignore[arg-type]
        plain = {name: _plain(value) for name, value in options.items()}
        query = urllib.parse.urlencode({"request": json.dumps(plain)})
        return self._send(f"/synthesize?{query}", body.getvalue())

    def set_gripper(self, name: str) -> dict[str, Any]:
        """Mount a gripper of the registry; answers its frames and postures."""
        return self._send("/gripper", json.dumps({"name": name}).encode())

    def status(self) -> dict[str, Any]:
        """Model, gripper that is on, grippers that there are, whether the planner is busy."""
        return self._send("/status")

    def _send(self, path: str, body: bytes | None = None) -> dict[str, Any]:
        request = urllib.request.Request(self._address + path, data=body)
        if self._token:
            request.add_header("Authorization", f"Bearer {self._token}")
        try:
            with urllib.request.urlopen(request, timeout=self._timeout) as answer:
                return json.load(answer)
        except urllib.error.HTTPError as error:
            try:
                told = json.load(error)["error"]
            except (ValueError, KeyError):
                told = {"code": 0, "message": f"{self._address} answered {error.code}"}
            raise PlannerError(told["code"], told["message"]) from None
        except OSError as error:
            raise PlannerError(
                0, f"no planner answers at {self._address} ({error}). Is `megrasp serve` running?"
            ) from None


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value
