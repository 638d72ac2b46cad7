from __future__ import annotations

import pytest

from pepperscene.colour.comparison import bootstrap


@pytest.fixture(scope="module", autouse=True)
def few_replicates(request):
    """Comparisons have 20 bootstrap replicates instead of 200, except where these are tested."""
    with pytest.MonkeyPatch.context() as patch:
        if request.path.name != "test_bootstrap.py":
            patch.setattr(bootstrap, "REPLICATES", 20)
        yield
