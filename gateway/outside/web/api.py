"""The REST interface under /api: one table of endpoints, from which the routes and the OpenAPI document are made.

Who may ask is decided here, once for all of them (`answer_request`): a session with a role for what changes something,
with the token of our own page (CSRF); reading as the configuration has it.
"""

import asyncio
import json
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.parse import urlsplit

from pydantic import Field, ValidationError
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response

from drivers.errors import OneLineError
from drivers.json_lines import NoObject, parse_object
from drivers.settings import ConfigError, Line, Section, first_sentence
from gateway.outside.status import ControlError, GatewayStatus
from gateway.outside.texts import LANGUAGES, preferred_language
from gateway.outside.web.access import AccountRole, AccountsError, Session
from gateway.outside.web.backing_up import BackupRefused
from gateway.outside.web.box import box_facts
from gateway.outside.web.openapi import document
from gateway.outside.web.promotion import PromotionRefused, promote_version
from gateway.outside.web.shift import NOBODY, NOTE, ON_SHIFT
from gateway.outside.web.shift_text import shift_text, shift_title
from gateway.outside.web.state import PageState, Unaccountable
from sim.strict_json import json_text

MOST_BODY = 8 * 1024
BODY_TIMEOUT_S = 10.0
"""How long a request's body may take to come."""
MOST_QUERY = 2_000
MAX_TIME_S = 1e10
MOST_COLUMNS = 8
"""How many tags a table of trends has; as many as the page shows at a time."""
COOKIE = "decanter_session"
TOKEN_HEADER = "x-csrf-token"  # noqa: S105 - the name of a header

OF_ENGINEERS = ("remove from service", "return to service")
"""Changes of an alarm that an operator may not make."""
ROLE_ORDER = list(AccountRole)


class Refused(Exception):
    """A request is not answered: the status, and one sentence."""

    def __init__(self, status: HTTPStatus, reason: str, headers: dict[str, str] | None = None) -> None:
        super().__init__(reason)
        self.status, self.reason, self.headers = status, reason, headers or {}


@dataclass(frozen=True, kw_only=True)
class Call:
    """One request: what it gives (checked), in which language, from which address, and whose it is."""

    page: PageState
    given: Any
    language: str
    address: str
    secret: str
    secure: bool
    session: Session | None
    role: AccountRole | None

    @property
    def who(self) -> str:
        """Name and address, for records."""
        return f"{self.session.name} at {self.address}" if self.session else self.address


@dataclass(frozen=True, kw_only=True)
class Endpoint:
    """A path under /api: what it is for, who may ask, what a request gives and what it is answered (JSON Schema)."""

    method: Literal["GET", "POST", "DELETE"]
    path: str
    summary: str
    answer: Callable[[Call], Awaitable[Any]]
    gives: type[Section] | None = None
    role: AccountRole | None = None
    open: bool = False
    media_type: str = "application/json"


class _None(Section):
    pass


# ---------------------------------------------------------------- one request


async def answer_request(page: PageState, endpoint: Endpoint, request: Request) -> Response:
    """The response to a request for an endpoint; whatever is wrong with it is one sentence."""
    try:
        call = await _admit(page, endpoint, request)
        plain = await endpoint.answer(call)
        if isinstance(plain, bytes):  # JSON of another process
            return Response(plain, media_type="application/json")
        return plain if isinstance(plain, Response) else as_json(plain)
    except Refused as refused:
        return as_json({"reason": refused.reason}, refused.status, refused.headers)
    except (ControlError, Unaccountable) as error:
        return as_json({"reason": str(error)}, HTTPStatus.CONFLICT)
    except AccountsError as error:
        return as_json({"reason": str(error)}, HTTPStatus.SERVICE_UNAVAILABLE)
    except (OSError, ValueError) as error:
        # What the historian's readers raise for a machine, a tag or a time that it has not.
        return as_json({"reason": str(error)}, HTTPStatus.NOT_FOUND)


def as_json(plain: Any, status: HTTPStatus = HTTPStatus.OK, headers: dict[str, str] | None = None) -> Response:
    """A response of strict JSON."""
    return Response(json_text(plain), status, headers, media_type="application/json")


async def _admit(page: PageState, endpoint: Endpoint, request: Request) -> Call:
    """The call that a request is, if it may be made. Raises Refused, AccountsError."""
    secret = request.cookies.get(COOKIE, "")[:200]
    changes = endpoint.method != "GET"
    found = page.sessions.find(secret, use=changes) if secret else None
    session, role = found if found else (None, None)
    if changes:
        _from_our_page(request, session, endpoint)
    if endpoint.role is not None:
        if session is None or role is None:
            raise Refused(HTTPStatus.UNAUTHORIZED, "log in first: this changes something, and needs a person")
        if ROLE_ORDER.index(role) < ROLE_ORDER.index(endpoint.role):
            page.note(
                "page: refused", f"{session.name} at {client_address(request)}", f"{role} may not {endpoint.path}"
            )
            raise Refused(HTTPStatus.FORBIDDEN, f"an account of the role {role} may not do this; {endpoint.role} may")
    elif session is None and not endpoint.open and not page.reading_is_open:
        raise Refused(HTTPStatus.UNAUTHORIZED, "log in first: this page shows nothing without an account")
    return Call(
        page=page,
        given=await _parse_request(endpoint, request),
        language=choose_language(request),
        address=client_address(request),
        secret=secret,
        secure=request.url.scheme == "https",
        session=session,
        role=role,
    )


def _from_our_page(request: Request, session: Session | None, endpoint: Endpoint) -> None:
    """Raises Refused for a request that another site may have had a browser make (CSRF)."""
    origin, host = request.headers.get("origin"), request.headers.get("host", "")
    if (origin is not None and urlsplit(origin).netloc != host) or request.headers.get("sec-fetch-site") in (
        "cross-site",
        "same-site",
    ):
        raise Refused(HTTPStatus.FORBIDDEN, "this request comes from another site's page")
    # No form can give this type, and a script of another site only after a question that nobody answers.
    if endpoint.gives is not None and request.headers.get("content-type", "").partition(";")[0] != "application/json":
        raise Refused(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "give the request as application/json")
    if session is not None and endpoint.role is not None and request.headers.get(TOKEN_HEADER) != session.token:
        raise Refused(HTTPStatus.FORBIDDEN, f"the header {TOKEN_HEADER} is not this session's; load the page anew")


async def _parse_request(endpoint: Endpoint, request: Request) -> Any:
    """What a request gives, as its endpoint has it. Raises Refused."""
    kind = endpoint.gives or _None
    if endpoint.method == "GET":
        query = str(request.url.query)
        if len(query) > MOST_QUERY:
            raise Refused(HTTPStatus.REQUEST_URI_TOO_LONG, f"the query is longer than {MOST_QUERY} characters")
        plain: dict[str, Any] = {key: value for key, value in request.query_params.items() if key != "lang"}
        place, strictly = "the query", False
    else:
        body = await _body(request)
        try:
            plain = parse_object(body, '{"name": "value"}') if body or endpoint.gives else {}
        except NoObject as error:
            raise Refused(HTTPStatus.BAD_REQUEST, str(error)) from None
        place, strictly = "the request", True
    try:
        return kind.model_validate(plain, strict=strictly)
    except ValidationError as error:
        raise Refused(HTTPStatus.UNPROCESSABLE_ENTITY, first_sentence(kind, error, place)) from None


async def _body(request: Request) -> bytes:
    body = bytearray()
    try:
        async with asyncio.timeout(BODY_TIMEOUT_S):
            async for chunk in request.stream():
                body += chunk
                if len(body) > MOST_BODY:
                    raise Refused(
                        HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
                        f"the request is longer than {MOST_BODY} bytes",
                        {"connection": "close"},
                    )
    except TimeoutError:
        raise Refused(
            HTTPStatus.REQUEST_TIMEOUT, f"the request did not come within {BODY_TIMEOUT_S:g} s", {"connection": "close"}
        ) from None
    except ClientDisconnect:
        raise Refused(HTTPStatus.BAD_REQUEST, "the client has gone") from None
    return bytes(body)


def client_address(request: Request) -> str:
    """The address that a request comes from."""
    return request.client.host if request.client else "unknown"


def choose_language(request: Request) -> str:
    """The language that a request names, else the one of the page it comes from, else the browser's."""
    for named in (request.query_params.get("lang"), request.cookies.get("decanter_language")):
        if named in LANGUAGES:
            return named
    return preferred_language(request.headers.get("accept-language", ""))


# ---------------------------------------------------------------- reading


Time = Annotated[float, Field(ge=-MAX_TIME_S, le=MAX_TIME_S, description="seconds since 1970 UTC")]
MachineName = Annotated[str, Field(min_length=1, max_length=60, description="a machine's name")]
TagName = Annotated[str, Field(min_length=1, max_length=200, description="a tag's name")]


class _OfMachine(Section):
    machine: MachineName


class _TimeSpanQuery(_OfMachine):
    start: Time
    end: Time


class _TrendQuery(_TimeSpanQuery):
    tag: TagName


class _ForecastQuery(_TimeSpanQuery):
    temperature: TagName
    horizon: float = Field(gt=0, le=86_400, description="one of the forecast's horizons, in seconds")


class _OneForecastQuery(_OfMachine):
    temperature: TagName
    at: Time


class _TableQuery(_TimeSpanQuery):
    tags: str = Field(min_length=1, max_length=MOST_QUERY, description="names of tags, a line each")


class _AlarmQuery(_OfMachine):
    most: int = Field(100, ge=1, le=1000, description="how many, 1 to 1000")


class _RatesQuery(Section):
    days: float = Field(7.0, gt=0, le=90, description="over how many days, up to 90")


class _ShiftQuery(Section):
    hours: float = Field(8.0, gt=0, le=24, description="over how many hours up to now, up to 24")


class _ScoreQuery(_OfMachine):
    temperature: TagName
    weeks: int = Field(4, ge=1, le=13, description="how many weeks, 1 to 13")


async def _plant(call: Call) -> Any:
    return await call.page.plant(call.language)


async def _machine(call: Call) -> Any:
    machines = (await call.page.plant(call.language))["machines"]
    if call.given.machine not in machines:
        names = ", ".join(machines)
        raise Refused(HTTPStatus.NOT_FOUND, f"there is no machine {call.given.machine!r}; there are {names}")
    return machines[call.given.machine]


async def _trend(call: Call) -> Any:
    g = call.given
    return await call.page.reader.trend(g.machine, g.tag, *_check_order(g))


async def _forecasts(call: Call) -> Any:
    g = call.given
    return await call.page.reader.forecasts(g.machine, g.temperature, g.horizon, *_check_order(g))


async def _forecast(call: Call) -> Any:
    g = call.given
    return await call.page.reader.forecast(g.machine, g.temperature, g.at)


async def _table(call: Call) -> Any:
    g = call.given
    tags = list(dict.fromkeys(tag for tag in g.tags.split("\n") if tag))
    if not 0 < len(tags) <= MOST_COLUMNS:
        reason = f"the query: tags: names {len(tags)} tags; name 1 to {MOST_COLUMNS}, a line each"
        raise Refused(HTTPStatus.UNPROCESSABLE_ENTITY, reason)
    text = await call.page.reader.table(g.machine, tags, *_check_order(g))
    return Response(text, headers={"content-disposition": 'attachment; filename="trend.csv"'}, media_type="text/csv")


def _check_order(given: Any) -> tuple[float, float]:
    if not given.start < given.end:
        raise Refused(HTTPStatus.UNPROCESSABLE_ENTITY, "the query: start: must be before end; give an earlier time")
    return given.start, given.end


async def _alarms(call: Call) -> Any:
    return await call.page.reader.alarms(call.given.machine, call.given.most)


async def _rates(call: Call) -> Any:
    return await call.page.reader.rates(call.given.days)


async def _notes(call: Call) -> Any:
    return await call.page.reader.notes(call.page.config.audit, call.given.machine, *_check_order(call.given))


async def _shift(call: Call) -> Any:
    """The limits are those of now: the records have none."""
    return await _report(call, await call.page.calls.plant())


async def _report(call: Call, statuses: Mapping[str, GatewayStatus]) -> bytes:
    limits = {
        name: {
            status.temperature: status.limit,
            **{one.temperature: one.limit for one in status.further},
            **status.watched,
        }
        for name, status in statuses.items()
    }
    end = max((status.time for status in statuses.values()), default=call.page.now())
    return await call.page.reader.shift(call.page.config.audit, end - 3600.0 * call.given.hours, end, limits)


async def _mail_shift(call: Call) -> Any:
    """To all who are told of alarms by mail, in the language of who sends it."""
    notify, words = call.page.config.notify, call.page.words[call.language]
    if not any(row.email for row in notify.to):
        reason = "nobody is told anything by mail; add a [[notify.to]] table with email to the plant file"
        raise Refused(HTTPStatus.CONFLICT, reason)
    statuses = await call.page.calls.plant()
    report = json.loads(await _report(call, statuses))
    units = {name: tag.unit for status in statuses.values() for name, tag in status.values.items()}
    text = shift_text(words, call.page.config.page.labels, units, report)
    await call.page.record("page: shift mailed", call.who, hours=call.given.hours)
    try:
        told, missed = await asyncio.to_thread(call.page.mail, shift_title(words, report), text, time.time())
    except (ConfigError, OneLineError) as error:
        raise Refused(HTTPStatus.BAD_GATEWAY, " ".join(str(error).split())) from None
    if not told:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in missed.items())
        raise Refused(HTTPStatus.BAD_GATEWAY, f"nobody was told: {reasons}")
    return {"told": told, "missed": missed}


async def _scorecard(call: Call) -> Any:
    g = call.given
    return await call.page.reader.scorecard(g.machine, g.temperature, g.weeks, await _known_locations(call))


async def _known_locations(call: Call) -> dict[str, bool | None]:
    """Of each location of the model that runs whether the machine runs in it (None: either); none where that cannot be
    asked now: what is on record can be scored without it."""
    try:
        reply = await call.page.calls.ask("model", machine=call.given.machine)
    except ControlError:
        return {}
    model = reply["temperatures"].get(call.given.temperature) or {"locations": []}
    return {place["name"]: place["runs"] for place in model["locations"]}


async def _model(call: Call) -> Any:
    reply = await call.page.calls.ask("model", machine=call.given.machine)
    return {"temperatures": reply["temperatures"]}


async def _box(call: Call) -> Any:
    return box_facts(call.page.config)


async def _document(call: Call) -> Any:
    return document(ENDPOINTS)


# ---------------------------------------------------------------- a person


class _LogIn(Section):
    name: str = Field(min_length=1, max_length=60, description="the account's name as text")
    password: str = Field(min_length=1, max_length=200, description="the password as text")


async def _who(call: Call) -> Any:
    """Who is logged in at this browser, if anybody."""
    if call.session is None or call.role is None:
        return {"name": None, "role": None, "token": None, "left": None}
    left = call.page.sessions.remaining_seconds(call.session)
    return {"name": call.session.name, "role": call.role, "token": call.session.token, "left": left}


async def _login(call: Call) -> Any:
    page, name = call.page, call.given.name
    if wait := page.lockout.wait(name, call.address):
        raise Refused(
            HTTPStatus.TOO_MANY_REQUESTS,
            f"too many wrong passwords; try again in {max(round(wait), 1)} s",
            {"retry-after": str(max(round(wait), 1))},
        )
    if not page.passwords.has_room(call.address):
        raise Refused(HTTPStatus.TOO_MANY_REQUESTS, "too many log-ins at a time; try again in a moment")
    account = page.accounts.get(name)
    if not await page.passwords.right(account, call.given.password, call.address):
        locked = page.lockout.failed(name, call.address)
        page.note("page: log-in locked" if locked else "page: log-in failed", f"{name[:40]} at {call.address}")
        raise Refused(HTTPStatus.UNAUTHORIZED, "the name or the password is wrong")
    if account is None:
        raise Refused(HTTPStatus.UNAUTHORIZED, "the name or the password is wrong")
    page.lockout.note_success(name, call.address)
    await page.record("page: logged in", f"{name} at {call.address}", role=account.role)
    page.sessions.close(call.secret)
    secret, session = page.sessions.open(name, account, call.address)
    left = page.sessions.remaining_seconds(session)
    response = as_json({"name": name, "role": account.role, "token": session.token, "left": left})
    response.set_cookie(COOKIE, secret, httponly=True, samesite="strict", secure=call.secure, path="/")
    return response


async def _logout(call: Call) -> Any:
    if call.session is not None:
        call.page.note("page: logged out", call.who)
    call.page.sessions.close(call.secret)
    response = as_json({"name": None})
    response.delete_cookie(COOKIE, httponly=True, samesite="strict", secure=call.secure, path="/")
    return response


class _AlarmChange(_OfMachine):
    alarm: Line = Field(description="the alarm's name as text")
    change: Literal["acknowledge", "reset", "shelve", "unshelve", "remove from service", "return to service"] = Field(
        "acknowledge", description="what is done with it, one of the `possible` changes of the alarm's status"
    )
    reason: Line | None = Field(None, description="why, as one line of text; an acknowledgement needs none")
    minutes: float | None = Field(None, gt=0, description="for how many minutes it is shelved, as a number")


class _ArmRequest(_OfMachine):
    reason: Line = Field(description="why blocks are to be written, as one line of text")
    minutes: float = Field(gt=0, description="for how many minutes, as a number")


class _DisarmRequest(_OfMachine):
    reason: Line = Field(description="why, as one line of text")


class _Promoting(_OfMachine):
    temperature: TagName
    version: Line = Field(description="one of the `versions` of the temperature's model, as text")
    reason: Line = Field(description="why it is to run, as one line of text")


class _Noting(_OfMachine):
    text: Line = Field(description="what is to be known of that moment, as one line of text")
    at: Time | None = Field(None, description="the moment that it is about, seconds since 1970 UTC; now without it")


class _Naming(Section):
    names: Line = Field(description=f"who is on shift, as one line of text; {NOBODY!r} for nobody")


class _Mailing(Section):
    hours: float = Field(gt=0, le=24, description="over how many hours up to now, as a number up to 24")


class _BackingUp(Section):
    pass


class _Reloading(Section):
    dry_run: bool = Field(False, description="true: only say what would change")


async def _change_alarm(call: Call) -> Any:
    """The change is a command of the control socket by its own name; which there are, and when, is the gateway's."""
    g = call.given
    if g.change in OF_ENGINEERS and call.role is AccountRole.OPERATOR:
        raise Refused(HTTPStatus.FORBIDDEN, f"an account of the role operator may not {g.change}; engineer may")
    if g.change == "acknowledge":
        # What somebody knows waits for no disk.
        call.page.note(f"page: {g.change}", call.who, g.reason or "", machine=g.machine, alarm=g.alarm)
    else:
        await call.page.record(f"page: {g.change}", call.who, g.reason or "", machine=g.machine, alarm=g.alarm)
    more = {key: value for key, value in (("reason", g.reason), ("minutes", g.minutes)) if value is not None}
    reply = await call.page.calls.ask(g.change, machine=g.machine, alarm=g.alarm, by=call.who, **more)
    return {"state": reply["state"]}


async def _arm(call: Call) -> Any:
    g = call.given
    await call.page.record("page: arm", call.who, g.reason, machine=g.machine, minutes=g.minutes)
    reply = await call.page.calls.ask("arm", machine=g.machine, by=call.who, reason=g.reason, minutes=g.minutes)
    return {"by": reply["by"], "reason": reply["reason"], "until": reply["until"]}


async def _disarm(call: Call) -> Any:
    g = call.given
    # Taking back waits for no record: it is on it afterwards where it could not be before.
    call.page.note("page: disarm", call.who, g.reason, machine=g.machine)
    reply = await call.page.calls.ask("disarm", machine=g.machine, by=call.who, reason=g.reason)
    return {"was_armed": reply["was_armed"]}


async def _promote(call: Call) -> Any:
    """The gateway takes over what its store has as current, as it does when somebody promotes it at the box."""
    g = call.given
    found = (await call.page.calls.ask("model", machine=g.machine))["temperatures"].get(g.temperature)
    if found is None or found["store"] is None:
        reason = f"the model of {g.temperature!r} is in no store of versions, so that there is nothing to promote"
        raise Refused(HTTPStatus.CONFLICT, reason)
    if g.version not in found["versions"]:
        known = ", ".join(found["versions"])
        raise Refused(HTTPStatus.NOT_FOUND, f"there is no version {g.version!r}; there are {known}")
    detail = {"machine": g.machine, "temperature": g.temperature, "version": g.version}
    await call.page.record("page: promote", call.who, g.reason, **detail)
    try:
        await promote_version(Path(found["store"]), g.version)
    except PromotionRefused as error:
        raise Refused(HTTPStatus.CONFLICT, str(error)) from None
    return {"version": g.version}


async def _note(call: Call) -> Any:
    now = call.page.now()
    at = now if call.given.at is None else call.given.at
    if at > now:
        raise Refused(HTTPStatus.UNPROCESSABLE_ENTITY, "the request: at: is yet to come; give a moment that has been")
    await _machine(call)
    await call.page.record(NOTE, call.who, call.given.text, machine=call.given.machine, at=at)
    return {"at": at}


async def _name_shift(call: Call) -> Any:
    await call.page.record(ON_SHIFT, call.who, call.given.names)
    return {"names": call.given.names}


async def _make_backup(call: Call) -> Any:
    try:
        folder = call.page.backups.next_folder()
        await call.page.record("page: backup", call.who, folder=str(folder))
        return await call.page.backups.make(folder)
    except BackupRefused as error:
        raise Refused(HTTPStatus.CONFLICT, str(error)) from None


async def _reload(call: Call) -> Any:
    await call.page.record("page: reload", call.who, dry_run=call.given.dry_run)
    reply = await call.page.calls.ask("reload", dry_run=call.given.dry_run)
    return {"changes": reply["changes"], "applied": reply["applied"]}


ENDPOINTS: Sequence[Endpoint] = (
    Endpoint(method="GET", path="/api/plant", summary="All machines: status, sentences, alarms.", answer=_plant),
    Endpoint(method="GET", path="/api/machine", summary="One machine.", answer=_machine, gives=_OfMachine),
    Endpoint(
        method="GET",
        path="/api/trend",
        summary="A tag over time: least, mean and greatest value, null where there is a gap.",
        answer=_trend,
        gives=_TrendQuery,
    ),
    Endpoint(
        method="GET",
        path="/api/forecasts",
        summary="What was said a horizon before each moment: the 5, 50 and 95 % quantiles as they were made.",
        answer=_forecasts,
        gives=_ForecastQuery,
    ),
    Endpoint(
        method="GET",
        path="/api/forecast",
        summary="The newest forecast up to a moment as it was made: the 5, 50 and 95 % quantiles at its horizons.",
        answer=_forecast,
        gives=_OneForecastQuery,
    ),
    Endpoint(
        method="GET",
        path="/api/table.csv",
        summary="Tags over time as a file: least, mean and greatest value by times in UTC.",
        answer=_table,
        gives=_TableQuery,
        media_type="text/csv",
    ),
    Endpoint(
        method="GET",
        path="/api/alarms",
        summary="The newest changes of a machine's alarms, the newest first.",
        answer=_alarms,
        gives=_AlarmQuery,
    ),
    Endpoint(
        method="GET",
        path="/api/rates",
        summary="How many alarms there were, of all machines, against what a person can deal with (EEMUA 191).",
        answer=_rates,
        gives=_RatesQuery,
    ),
    Endpoint(
        method="GET",
        path="/api/scorecard",
        summary="How right the predictions and warnings of a temperature were, week by week, from the records.",
        answer=_scorecard,
        gives=_ScoreQuery,
    ),
    Endpoint(
        method="GET",
        path="/api/notes",
        summary="What people have noted of moments of a machine in a stretch, the newest.",
        answer=_notes,
        gives=_TimeSpanQuery,
    ),
    Endpoint(
        method="GET",
        path="/api/shift",
        summary="What happened in the last hours: alarms and what came of them, the hottest, who did what.",
        answer=_shift,
        gives=_ShiftQuery,
    ),
    Endpoint(
        method="GET",
        path="/api/model",
        summary="The models that run: where they come from, locations and edges, the present location.",
        answer=_model,
        gives=_OfMachine,
    ),
    Endpoint(method="GET", path="/api/box", summary="The computer: disk, memory, load, uptime.", answer=_box),
    Endpoint(method="GET", path="/api/session", summary="Who is logged in.", answer=_who, open=True),
    Endpoint(method="POST", path="/api/session", summary="Log in.", answer=_login, gives=_LogIn, open=True),
    Endpoint(method="DELETE", path="/api/session", summary="Log out.", answer=_logout, open=True),
    Endpoint(
        method="POST",
        path="/api/alarm",
        summary="Acknowledge an alarm, or whatever else is possible with it.",
        answer=_change_alarm,
        gives=_AlarmChange,
        role=AccountRole.OPERATOR,
    ),
    Endpoint(
        method="POST",
        path="/api/notes",
        summary="Note something about a moment of a machine; it is in the audit log, with the name.",
        answer=_note,
        gives=_Noting,
        role=AccountRole.OPERATOR,
    ),
    Endpoint(
        method="POST",
        path="/api/shift/mail",
        summary="Mail the report of the last hours to all who are told of alarms by mail.",
        answer=_mail_shift,
        gives=_Mailing,
        role=AccountRole.OPERATOR,
    ),
    Endpoint(
        method="POST",
        path="/api/shift",
        summary="Say who is on shift, for a day at most.",
        answer=_name_shift,
        gives=_Naming,
        role=AccountRole.OPERATOR,
    ),
    Endpoint(
        method="POST",
        path="/api/arm",
        summary="Let blocks be written to the PLC.",
        answer=_arm,
        gives=_ArmRequest,
        role=AccountRole.ENGINEER,
    ),
    Endpoint(
        method="POST",
        path="/api/disarm",
        summary="Take everything back at the PLC, and write no more.",
        answer=_disarm,
        gives=_DisarmRequest,
        role=AccountRole.ENGINEER,
    ),
    Endpoint(
        method="POST",
        path="/api/promote",
        summary="Prove a version of a model's store, and have it run.",
        answer=_promote,
        gives=_Promoting,
        role=AccountRole.ENGINEER,
    ),
    Endpoint(
        method="POST",
        path="/api/backup",
        summary="Copy all that the gateway is into a new folder beside its records.",
        answer=_make_backup,
        gives=_BackingUp,
        role=AccountRole.ADMINISTRATOR,
    ),
    Endpoint(
        method="POST",
        path="/api/reload",
        summary="Read the plant file anew.",
        answer=_reload,
        gives=_Reloading,
        role=AccountRole.ADMINISTRATOR,
    ),
    Endpoint(method="GET", path="/api/openapi.json", summary="This document.", answer=_document, open=True),
)
"""Everything that can be asked; a new one is a row here."""
