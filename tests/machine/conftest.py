"""The refusals of machine files."""

from __future__ import annotations

import pytest

from threadline.errors import MachineError
from threadline.machine import load_machine


@pytest.fixture
def refused(tmp_path):
    """Return the refusal of a machine file with this text."""

    def refuse(text: str | bytes) -> str:
        path = tmp_path / "mine.toml"
        if isinstance(text, str):
            path.write_text(text, encoding="utf-8")
        else:
            path.write_bytes(text)
        with pytest.raises(MachineError) as caught:
            load_machine(path)
        message = str(caught.value)
        assert message.startswith("[MACHINE] ")
        assert "\n" not in message
        return message

    return refuse
