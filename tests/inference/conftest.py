"""A plate in a laboratory (`laboratory.Laboratory`), built once for all tests of inference."""

from __future__ import annotations

import pytest
from laboratory import Laboratory


@pytest.fixture(scope="session")
def lab() -> Laboratory:
    return Laboratory()
