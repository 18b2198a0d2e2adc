"""The REST interface against its own OpenAPI document, by requests that schemathesis makes up: right and wrong ones.

Each operation is asked by an administrator, so that nothing stops at the door: no answer is a failure of the gateway's,
and each is one that the document has. schemathesis is no part of the locked development set (record 0129).
"""

from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, given, settings

from gateway.outside.web.access import AccountRole
from gateway.outside.web.api import ENDPOINTS
from tests.page.served import Client, served

schemathesis = pytest.importorskip(
    "schemathesis", reason="schemathesis is not installed (`uv pip install schemathesis`)"
)
from schemathesis.checks import not_a_server_error  # noqa: E402 - only where it is there
from schemathesis.generation import GenerationMode  # noqa: E402
from schemathesis.specs.openapi.checks import (  # noqa: E402
    content_type_conformance,
    negative_data_rejection,
    response_schema_conformance,
    status_code_conformance,
)

CHECKS = [
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_schema_conformance,
    negative_data_rejection,
]
CONFIG = schemathesis.Config.from_dict({"checks": {"negative_data_rejection": {"expected-statuses": ["4xx"]}}})
REQUESTS = 40
"""Of each operation, right ones and as many wrong ones."""


@pytest.fixture(scope="module")
def ada(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    with served(tmp_path_factory.mktemp("page"), accounts={"ada": AccountRole.ADMINISTRATOR}) as running:
        client = Client(running.port)
        assert client.log_in("ada") == 200
        yield client


CASES = [
    pytest.param(endpoint, mode, id=f"{endpoint.method} {endpoint.path} {mode.value}")
    # What is made up as a log-in locks the address, and a log-out ends the session: those come last.
    for endpoint in sorted(ENDPOINTS, key=lambda each: each.path == "/api/session")
    for mode in GenerationMode
    # What takes nothing cannot be given anything wrong.
    if mode is GenerationMode.POSITIVE or (endpoint.gives is not None and endpoint.gives.model_fields)
]


@pytest.mark.parametrize(("endpoint", "mode"), CASES)
def test_every_answer_is_one_that_the_document_has(ada: Client, endpoint: Any, mode: Any) -> None:
    schema = schemathesis.openapi.from_dict(ada.ask("GET", "/api/openapi.json")[1], config=CONFIG)
    operation = schema[endpoint.path][endpoint.method]
    name, _, session = ada.cookie.partition("=")
    asked = 0

    @settings(
        max_examples=REQUESTS,
        derandomize=True,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(case=operation.as_strategy(generation_mode=mode))
    def ask(case: Any) -> None:
        nonlocal asked
        asked += 1
        case.cookies = {name: session}
        case.headers = {**(case.headers or {}), "x-csrf-token": ada.token}
        case.call_and_validate(base_url=f"http://127.0.0.1:{ada.port}", checks=CHECKS, timeout=120.0)

    ask()
    assert asked
    assert ada.ask("GET", "/api/plant")[1]["machines"]["decanter"]["status"]["failures"] == 0
