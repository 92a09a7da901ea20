"""`python -m docs.generating` writes the generated parts anew; `tests/docs/test_generated.py` holds that they are."""

from docs.generating.parts import PARTS, with_part

for page, part in PARTS.items():
    page.write_text(with_part(page.read_text(encoding="utf-8"), part()), encoding="utf-8")
