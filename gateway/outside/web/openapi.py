"""The OpenAPI document (3.1) of the REST interface, from its table of endpoints and the models of what they get."""

from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gateway.outside.web.api import Endpoint

REASON = {"type": "object", "properties": {"reason": {"type": "string"}}, "required": ["reason"]}
REFUSALS = {
    "400": "The body is no JSON object in UTF-8.",
    "401": "Nobody is logged in.",
    "403": "The account's role does not suffice, or the request comes from another page.",
    "404": "There is no such machine, tag or row.",
    "408": "The body has not come in time.",
    "409": "The gateway refuses it.",
    "413": "The body is too long.",
    "414": "The query is too long.",
    "415": "The body is of another type than application/json.",
    "422": "The request is not as described.",
    "429": "Too many wrong passwords, or too many at a time.",
    "502": "The mail server takes it for nobody, or cannot be asked.",
    "503": "The gateway cannot answer now.",
}


def document(endpoints: Iterable["Endpoint"]) -> dict[str, Any]:
    """The document as plain values."""
    try:
        release = version("decanter-gateway")
    except PackageNotFoundError:
        release = "0"
    paths: dict[str, dict[str, Any]] = {}
    for endpoint in endpoints:
        paths.setdefault(endpoint.path, {})[endpoint.method.lower()] = _operation(endpoint)
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "Decanter gateway",
            "version": release,
            "description": "What the page shows, as JSON. Times are seconds since 1970 UTC; null is what is not known.",
        },
        "paths": paths,
        "components": {
            "securitySchemes": {
                "session": {"type": "apiKey", "in": "cookie", "name": "decanter_session"},
                "token": {"type": "apiKey", "in": "header", "name": "x-csrf-token"},
            }
        },
    }


def _operation(endpoint: "Endpoint") -> dict[str, Any]:
    refused = {
        code: {"description": words, "content": {"application/json": {"schema": REASON}}}
        for code, words in REFUSALS.items()
    }
    operation: dict[str, Any] = {
        "summary": endpoint.summary,
        "operationId": f"{endpoint.method.lower()}_{endpoint.path.rpartition('/')[2].partition('.')[0]}",
        "responses": {
            "200": {
                "description": endpoint.summary,
                "content": {
                    endpoint.media_type: {
                        "schema": {"type": "object" if endpoint.media_type == "application/json" else "string"}
                    }
                },
            },
            **refused,
        },
    }
    if endpoint.role is not None:
        operation["description"] = f"Needs an account of the role {endpoint.role} or above."
        operation["security"] = [{"session": [], "token": []}]
    schema = endpoint.gives.model_json_schema() if endpoint.gives else {"properties": {}}
    if endpoint.method == "GET":
        needed = schema.get("required", ())
        operation["parameters"] = [
            {"name": name, "in": "query", "required": name in needed, "schema": rule}
            for name, rule in schema["properties"].items()
        ]
    elif endpoint.gives is not None:
        operation["requestBody"] = {"required": True, "content": {"application/json": {"schema": schema}}}
    return operation
