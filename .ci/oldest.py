"""Print the oldest versions that pyproject.toml declares, as pip takes them.

``python .ci/oldest.py symbolic test:pytest``: the dependencies, those of each extra named, and of ``extra:name`` that
one alone.
"""

import re
import sys
import tomllib
from pathlib import Path

project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
asked = list(project["dependencies"])
for extra in sys.argv[1:]:
    group, _, only = extra.partition(":")
    asked += [one for one in project["optional-dependencies"][group] if not only or re.match(rf"{only}[\[>]", one)]
for requirement in asked:
    found = re.match(r"([A-Za-z0-9_.\[\]-]+?)>=([0-9.]+)", requirement)
    if found is None:
        sys.exit(f"pyproject.toml: {requirement!r} names no oldest version; write it as name>=version")
    print(f"{found[1]}=={found[2]}")
