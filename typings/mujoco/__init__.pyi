# mujoco ships no stubs that pyright can use: its classes are made by the extension module.
from typing import Any

def __getattr__(name: str) -> Any: ...
