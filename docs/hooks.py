"""Pages that are made when the documentation is built: the reference of every public module, and the model card.

The reference is read from the source by mkdocstrings, without importing it. The model card is made of
`models/parameters` and `models/coefficients`, so that no number is typed twice.
"""

from pathlib import Path
from typing import Any

import yaml
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("workbench", "optimisation", "hardware")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the generated pages to those of the folder."""
    pages = {**_reference(), **_model_card()}
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    for entry in config.nav or []:
        if entry.get("Reference") == "reference/":
            entry["Reference"] = _reference_navigation(pages)
    return files


def _reference() -> dict[str, str]:
    pages = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            if "_models" in parts or (parts[-1].startswith("_") and parts[-1] != "__init__"):
                continue
            module = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            pages[f"reference/{module}.md"] = (
                f"# {module}\n\n::: {module}\n    options:\n      show_root_heading: false\n"
            )
    return pages


def _reference_navigation(pages: dict[str, str]) -> list[dict[str, Any]]:
    """One entry per package, its modules below."""
    navigation: list[dict[str, Any]] = []
    for package in PACKAGES:
        own = sorted(name for name in pages if name.startswith((f"reference/{package}.", f"reference/{package}/")))
        navigation.append({package: [{Path(name).stem: name} for name in own]})
    return navigation


def _model_card() -> dict[str, str]:
    return {"parameters/parameters.md": _parameters(), "parameters/coefficients.md": _coefficients()}


def _parameters() -> str:
    folder = ROOT / "models" / "parameters"
    lines = [
        "# Model card: every parameter",
        "",
        "Made from `models/parameters`; each number stands there once. A *prior* is the range that an assumed number "
        "may have, and that the calibration searches.",
    ]
    for path in sorted(folder.rglob("*.yaml")):
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        entries = {key: entry for key, entry in content.items() if isinstance(entry, dict) and "value" in entry}
        if not entries:
            continue
        section = path.relative_to(folder).with_suffix("").as_posix()
        lines += [
            "",
            f"## {section}",
            "",
            "| parameter | value | unit | source | prior | reason |",
            "|---|---|---|---|---|---|",
        ]
        for key, entry in entries.items():
            prior = " to ".join(f"{bound:g}" for bound in entry["prior"]) if entry.get("prior") else ""
            cells = (
                f"`{key}`",
                _shown(entry["value"]),
                entry["unit"],
                entry["source"],
                prior,
                entry.get("reason") or "",
            )
            lines.append("| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def _shown(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _coefficients() -> str:
    lines = [
        "# Coefficient sets",
        "",
        "The aerodynamic coefficient sets that ship in `models/coefficients`; `aerodima coefficients plot NAME` "
        "draws one. The law that reads them: `workbench/aero/README.md`.",
    ]
    for path in sorted((ROOT / "models" / "coefficients").glob("*.yaml")):
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        lines += ["", f"## {path.stem}", "", "| key | content |", "|---|---|"]
        for key, value in content.items():
            text = (
                str(value)
                if not isinstance(value, list | dict)
                else yaml.safe_dump(value, default_flow_style=True, width=10**6).strip()
            )
            short = text if len(text) <= 240 else f"{text[:237]}..."
            lines.append(f"| `{key}` | {short.replace('|', chr(92) + '|')} |")
    return "\n".join(lines) + "\n"
