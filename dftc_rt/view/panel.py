"""The panel of faults: joint, kind and amount; apply and clear on the rig that runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from dftc_rt.config import toml
from dftc_rt.errors import DftcError
from dftc_rt.fault_socket import Apply, Clear, Request, ask


@dataclass(frozen=True)
class _Kind:
    """A kind of fault as the panel offers it: one number, and what it makes of the table."""

    unit: str
    amount: float
    table: Callable[[float], dict[str, Any]]


_KINDS: Final = {
    "loss": _Kind("%", 40.0, lambda x: {"effectiveness": 1.0 - x / 100.0}),
    "total": _Kind("", 0.0, lambda x: {}),
    "bias": _Kind("Nm", 5.0, lambda x: {"torque_nm": x}),
    "saturation": _Kind("% of the limit", 20.0, lambda x: {"limit": x / 100.0}),
    "dead_zone": _Kind("Nm", 2.0, lambda x: {"width_nm": x}),
    "lag": _Kind("ms", 10.0, lambda x: {"lag_s": x / 1e3}),
    "stuck_torque": _Kind("", 0.0, lambda x: {}),
    "lock": _Kind("", 0.0, lambda x: {}),
    "friction": _Kind("times", 3.0, lambda x: {"factor": x}),
    "payload": _Kind("kg", 1.0, lambda x: {"payload_kg": x}),
    "sensor_bias": _Kind("mrad", 5.0, lambda x: {"bias_rad": x / 1e3}),
    "sensor_frozen": _Kind("", 0.0, lambda x: {}),
    "silent": _Kind("", 0.0, lambda x: {}),
}
"""Those that one number describes; ``dftc fault apply`` has the others."""


class FaultPanel:
    """Sends what is clicked to the rig, and shows its answer."""

    def __init__(self, gui: Any, joints: tuple[str, ...], directory: Path) -> None:
        """Add the panel.

        Args:
            gui: ``gui`` of a ``viser.ViserServer``.
            joints: Joint names.
            directory: Where the rig takes faults.
        """
        self._directory = directory
        with gui.add_folder("faults"):
            self._joint = gui.add_dropdown("joint", joints, initial_value=joints[0])
            self._kind = gui.add_dropdown("kind", tuple(_KINDS), initial_value="loss")
            self._amount = gui.add_number("amount", _KINDS["loss"].amount, step=0.1)
            self._apply = gui.add_button(self._label, color="orange")
            self._clear = gui.add_button("clear")
            self._clear_all = gui.add_button("clear all")
            self._said = gui.add_markdown("")
        self._kind.on_update(lambda _: self._choose())
        self._amount.on_update(lambda _: self._rename())
        self._apply.on_click(lambda _: self._send(self._fault))
        self._clear.on_click(
            lambda _: self._send(lambda: Clear(joint=self._joint.value, kind=self._kind.value))
        )
        self._clear_all.on_click(lambda _: self._send(Clear))

    @property
    def _label(self) -> str:
        """What the button does: ``apply 40 % loss``."""
        unit = _KINDS[self._kind.value].unit
        amount = f"{self._amount.value:g} {unit} " if unit else ""
        return f"apply {amount}{self._kind.value}"

    def _choose(self) -> None:
        kind = _KINDS[self._kind.value]
        self._amount.disabled = not kind.unit
        self._amount.value = kind.amount
        self._rename()

    def _rename(self) -> None:
        self._apply.label = self._label

    def _fault(self) -> Request:
        """What the panel shows.

        Raises:
            InputError: The amount is out of range.
        """
        table = _KINDS[self._kind.value].table(float(self._amount.value))
        fault = {"joint": self._joint.value, "kind": self._kind.value, **table}
        return toml.convert({"do": "apply", "fault": fault}, Apply, "fault")

    def _send(self, make: Callable[[], Request]) -> None:
        try:
            answer = ask(self._directory, make())
            self._said.content = f"t {answer.t:.2f} s: {answer.text}"
        except DftcError as error:
            self._said.content = f"refused: {error}"
