"""Write the schema of the panel's protocol into the documentation."""

import json
from pathlib import Path

from threadline.panel.protocol import schema

FILE = Path(__file__).parents[1] / "docs" / "panel-protocol.json"

if __name__ == "__main__":
    FILE.write_text(json.dumps(schema(), indent=1) + "\n", encoding="utf-8")
