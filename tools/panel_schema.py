"""Write the schema of the panel's protocol into the documentation."""

import json
from pathlib import Path

from threadline.machine import load_machine
from threadline.panel.admission import Admission
from threadline.panel.calculation import Calculation, MachineGuide
from threadline.panel.owner_process import Owned, OwnerLink, start_owner
from threadline.panel.panel import Panel
from threadline.panel.server import make_api, schema_of

FILE = Path(__file__).parents[1] / "docs" / "panel-protocol.json"

if __name__ == "__main__":
    machine, here = load_machine("lathe-winder"), Path()
    owner = OwnerLink(lambda: start_owner(Owned(machine, None, here, here, 1.0)))  # not called
    panel = Panel(machine, owner, Calculation(machine, None, here, here))
    schema = schema_of(
        make_api(panel, MachineGuide(machine, here), here, here, Admission("127.0.0.1", ""))
    )
    FILE.write_text(json.dumps(schema, indent=1) + "\n", encoding="utf-8")
