"""Python's logging (the core uses it) into a node's log."""

from __future__ import annotations

import logging

from rclpy.impl.rcutils_logger import RcutilsLogger


class _NodeHandler(logging.Handler):
    """Passes records on."""

    def __init__(self, logger: RcutilsLogger) -> None:
        super().__init__()
        self._logger = logger

    def emit(self, record: logging.LogRecord) -> None:
        text = self.format(record)
        # rclpy ties one severity to one place in the code, so each gets its own line.
        if record.levelno >= logging.ERROR:
            self._logger.error(text)
        elif record.levelno >= logging.WARNING:
            self._logger.warning(text)
        else:
            self._logger.info(text)


def forward_logs(source: logging.Logger, target: RcutilsLogger) -> None:
    """Send the records of `source` (level INFO and above) to a node's logger."""
    source.setLevel(logging.INFO)
    source.addHandler(_NodeHandler(target))
    source.propagate = False
