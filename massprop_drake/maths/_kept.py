"""Cache files of compiled code, checked before use; loads numba, so only `kernels` loads it.

numba reads what it kept as it finds it, and a file that was cut off by a full disk ends every later process. Here each
file ends with a digest of its content. One that is not whole is compiled anew, which is said once; one that cannot be
written is not kept.
"""

from __future__ import annotations

import hashlib
import logging
import pickle
from pathlib import Path
from typing import Any

from numba.core.caching import IndexDataCacheFile

_LOG = logging.getLogger("massprop_drake")
_DIGEST = hashlib.sha256().digest_size  # bytes at the end of a file
_SAID: set[str] = set()


class _CheckedFile(IndexDataCacheFile):  # type: ignore[misc] # numba has no types
    """Index and data files of one function, with a digest at the end of each, which `pickle` passes over."""

    def load(self, key: Any) -> Any:
        """Loads a function's cached code for argument types; None where no undamaged file exists."""
        try:
            return super().load(key)
        except Exception as error:
            self._log_damage(self._index_path, error)
            return None

    def save(self, key: Any, data: Any) -> None:
        """Writes a function's compiled code for argument types to the cache; logs where it cannot be written."""
        try:
            super().save(key, data)
        except OSError as error:
            _log_once("unwritten", f"compiled kernels cannot be kept in {self._cache_path} ({error.strerror})")

    def _dump(self, obj: Any) -> bytes:
        """Serializes an object, with the SHA-256 digest of its bytes appended."""
        content: bytes = super()._dump(obj)
        return content + hashlib.sha256(content).digest()

    def _load_index(self) -> Any:
        """Loads the cache's index of compiled code of a function; empty where its file is missing or damaged."""
        try:
            with Path(self._index_path).open("rb") as file:
                pickle.load(file)  # the version, which stands before the rest
                _require_whole(file.read())
            return super()._load_index()
        except FileNotFoundError:
            return {}
        except Exception as error:
            self._log_damage(self._index_path, error)
            return {}

    def _load_data(self, name: str) -> Any:
        """Loads compiled code from a data file; ValueError when its digest does not match."""
        path = self._data_path(name)
        _require_whole(Path(path).read_bytes())
        return super()._load_data(name)

    def _log_damage(self, path: str, error: Exception) -> None:
        """Logs once that a cache file is damaged and its code is compiled again."""
        _log_once("damaged", f"what is kept in {Path(path).parent} is damaged ({error!r:.60}) and is compiled anew")


def _require_whole(content: bytes) -> None:
    """Raises ValueError when a file's content does not match the digest at its end."""
    if hashlib.sha256(content[:-_DIGEST]).digest() != content[-_DIGEST:]:
        raise ValueError("not what was written")


def _log_once(kind: str, message: str) -> None:
    """Logs a warning, once per kind of message in a process."""
    if kind not in _SAID:
        _SAID.add(kind)
        _LOG.warning("%s", message)


def check_cache_files(dispatcher: Any) -> Any:
    """Returns a compiled function that checks its cache files; unchanged with another version of numba."""
    cache = getattr(dispatcher, "_cache", None)
    file = getattr(cache, "_cache_file", None)
    if type(file) is IndexDataCacheFile:
        file.__class__ = _CheckedFile
    return dispatcher
