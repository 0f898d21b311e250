"""The laboratory, made once."""

from __future__ import annotations

import pytest
from laboratory import Laboratory


@pytest.fixture(scope="session")
def lab() -> Laboratory:
    return Laboratory()
