"""The page on the published identification has a check for each claim."""

import pytest

from haptid.demos import read_demo


@pytest.fixture(scope="module")
def page(request):
    return (request.config.rootpath / "docs/phantom.md").read_text(encoding="utf-8")


def test_every_claim_is_on_the_page(page):
    for claim in read_demo("phantom").claims:
        assert f"| {claim.name} |" in page
        assert claim.check in page
