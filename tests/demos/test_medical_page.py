"""The page on the two branches has a check for each claim."""

import pytest

from haptid.demos import read_demo


@pytest.fixture(scope="module")
def page(request):
    return (request.config.rootpath / "docs/medical.md").read_text(encoding="utf-8")


def test_every_claim_is_on_the_page_and_its_check_is_there(page, request):
    tests = request.config.rootpath / "tests"
    files = [*(tests / "golden").glob("*.py"), tests / "excitation/test_wide_example.py"]
    checks = [path.read_text(encoding="utf-8") for path in files]
    claims = read_demo("medical").claims
    assert [claim.name for claim in claims] == [f"T{k}" for k in range(1, 10)]
    for claim in claims:
        assert f"| {claim.name} |" in page
        assert claim.check in page
        assert any(f"def {claim.check}(" in text for text in checks), claim.check
