"""The software bill of materials of this environment: dynid and all that it requires, as CycloneDX 1.5 (JSON).

    python -m studies.sbom > build/sbom.json

Versions and licences are those that the installed packages state; nothing is looked up elsewhere.
"""

from __future__ import annotations

import json
import re
from importlib.metadata import Distribution, PackageNotFoundError, distribution


def required(name: str, found: dict[str, Distribution]) -> None:
    """Add a package and what it requires without extras; what is not installed here is not needed here."""
    key = re.sub(r"[-_.]+", "-", name).lower()
    if key in found:
        return
    try:
        found[key] = distribution(name)
    except PackageNotFoundError:
        return
    for text in found[key].requires or ():
        if "extra ==" not in text:
            required(re.split(r"[^\w.-]", text, maxsplit=1)[0], found)


def licence(of: Distribution) -> str:
    """The licence as the package states it, in one line; empty where it states none."""
    stated = next((of.metadata[key] for key in ("License-Expression", "License") if key in of.metadata), "")
    classified = [
        line.rpartition("::")[2].strip() for line in of.metadata.get_all("Classifier", []) if "License ::" in line
    ]
    return stated.splitlines()[0].strip() if stated and len(stated) < 100 else ", ".join(classified)


def main() -> None:
    """Print the document."""
    found: dict[str, Distribution] = {}
    required("dynid", found)
    components = []
    for key, of in sorted(found.items()):
        named = {"type": "library", "name": key, "version": of.version, "purl": f"pkg:pypi/{key}@{of.version}"}
        stated = licence(of)
        components.append(named | ({"licenses": [{"license": {"name": stated}}]} if stated else {}))
    print(
        json.dumps({"bomFormat": "CycloneDX", "specVersion": "1.5", "version": 1, "components": components}, indent=1)
    )


if __name__ == "__main__":
    main()
