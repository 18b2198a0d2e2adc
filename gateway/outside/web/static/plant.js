// The plant (a row a temperature) and one machine.
import { byWhom, clock, duration, explained, fact, h, number, say, shown, unit, withUnit } from "./dom.js";
import { age, isCut, state } from "./live.js";
import { fanChart, sparkline, strip } from "./draw.js";
import { alarmTable, can, waits } from "./records.js";

const SIGNS = { normal: "", over: "↩", attention: "!", unknown: "?", alarm: "!!" };

// The least first, as the gateway has them.
export const worstLevel = (rows) => Object.keys(SIGNS).findLast((level) => rows.some((row) => row.level === level));

export const sign = (level) =>
  h("span", { class: `sign ${level}`, title: say(`level.${level}`) }, h("span", { "aria-hidden": "true" }, SIGNS[level]), h("span", { class: "hidden" }, say(`level.${level}`)));

// A value that is not a present one is never shown like one: what it was, and that it was.
export function value(row, machine) {
  const text = row.value === null ? "–" : withUnit(number(row.value), row.unit);
  return isCut(machine) && row.value !== null ? h("span", { class: "old" }, say("live.was", { value: text })) : text;
}

// Its sentence and what that is worth: of what was, where nothing is known of now.
function sentence(row, machine) {
  if (!isCut(machine)) return [row.sentence, row.validity];
  return [say("live.before", { age: duration(age(machine)), sentence: row.sentence }), say("validity.none")];
}

// What there is to say of a temperature that has a limit and no model.
const WATCHED = { forecast: null, prediction: null };
const forecastOf = (machine, tag) => {
  const status = machine.status;
  return status.temperature === tag ? status : status.further.find((one) => one.temperature === tag) || WATCHED;
};

export function badge(writeback) {
  const mode = writeback.mode;
  const until = writeback.armed_until ? clock(writeback.armed_until) : "";
  const words = mode === "armed"
    ? say("word.armed_by", { by: byWhom(writeback.armed_by), until, reason: writeback.armed_reason || "" })
    : say(`word.${mode}_means`);
  return h("span", { class: `badge ${mode}` }, h("b", {}, say(`word.${mode}`)), " ", h("span", {}, words));
}

// The mode of writing in one word, of a machine or the worst of several; of what was, where nothing is known of now.
export function modeBadge(mode, cut, of = "") {
  const text = say(`word.${mode}`) + of;
  return h("span", { class: `badge ${cut ? "off" : mode}`, title: `${say("word.writeback")}: ${text}` }, cut ? say("live.was", { value: text }) : h("b", {}, text));
}

// Each temperature of each machine, with its alarms (its first row has the machine's own) and the worst level of all.
const temperatureRows = () => state.order.flatMap((name) => {
  const machine = state.machines[name];
  return machine.temperatures.map((row) => {
    const alarms = machine.alarms.filter((alarm) => row.alarms.includes(alarm.name));
    return { name, machine, row, alarms, level: worstLevel([row, ...alarms]), cut: isCut(name) };
  });
});

const pictureOf = ({ name, machine, row }) => sparkline(name, row, forecastOf(machine, row.tag).forecast, machine.status.speed);

// The three figures of a temperature: what it is, when it is at its limit, what is to be done about it.
const figures = ({ name, row, cut }) => [
  h("span", { class: "figure now" }, h("small", {}, say("word.measured")), h("span", { class: "big" }, value(row, name)), h("small", {}, `${say("word.limit")} ${withUnit(number(row.limit), row.unit)}`)),
  h("span", { class: `figure when ${row.valid}` }, h("small", {}, say("when.title")), h("span", { class: "amount" }, cut ? "–" : row.when[0]), h("small", {}, cut ? say("word.unknown") : row.when[1])),
  h("span", { class: "figure action" }, h("small", {}, say("action.title")), h("span", { class: "doing" }, cut ? "–" : row.action))];

// Rows keep their places. Of more than are seen at once those that ask for something stand above them too, the worst
// first and of these the soonest: which it is needs no search.
const SEEN_AT_ONCE = 2, MOST_ASKING = 5;
function askingRows(rows) {
  // Of one that nothing is heard of nothing is known: it stays, as that.
  const asking = rows.map((each) => (each.cut ? { ...each, level: "unknown" } : each)).filter((each) => rank(each) >= rank({ level: "attention" }));
  if (rows.length <= SEEN_AT_ONCE || !asking.length) return null;
  asking.sort((a, b) => rank(b) - rank(a) || excess(b) - excess(a) || soonest(a) - soonest(b));
  // Under a pointer or the focus nothing changes its place: what is clicked is what was aimed at.
  if (document.querySelector(".asking:is(:hover, :focus-within)")) {
    const place = (each) => { const at = order.indexOf(keyOf(each)); return at < 0 ? Infinity : at; };
    asking.sort((a, b) => (place(a) === place(b) ? 0 : place(a) - place(b)));
  }
  order = asking.map(keyOf);
  return h("ul", { class: "asking", "data-key": "asking", "aria-label": say("plant.asking") }, asking.slice(0, MOST_ASKING).map(({ name, machine, row, level, alarms, cut }) => h("li", { "data-key": `${name} ${row.tag}` },
    h("a", { href: `#/machine/${encodeURIComponent(name)}` }, sign(level), h("span", {}, h("b", {}, machine.label), ` ${row.label}: ${why(row, alarms, cut)}`)))),
    asking.length > MOST_ASKING && h("li", {}, `+ ${asking.length - MOST_ASKING}`));
}
let order = [];
const keyOf = ({ name, row }) => `${name} ${row.tag}`;
const excess = ({ row, cut }) => (cut || row.value === null ? 0 : Math.max(row.value - row.limit, 0));
const soonest = ({ machine, row }) => forecastOf(machine, row.tag).forecast?.block.minutes_median ?? Infinity;
// What it asks for something by: that it is not known or above its limit, its worst alarm, or when it is at its limit.
function why(row, alarms, cut) {
  if (cut) return say("word.unknown");
  if (row.level === "alarm" || row.level === "unknown") return row.when[1];
  const standing = alarms.filter((alarm) => alarm.section === "standing"), worst = standing.find((alarm) => alarm.level === worstLevel(standing));
  return worst?.title ?? `${say("when.title")} ${row.when[0]}`;
}

const aboveRows = (...parts) => parts.some(Boolean) && h("div", { class: "above", "data-key": "above" }, parts);

export function plantView() {
  const rows = temperatureRows();
  return h("section", { class: "plant", "aria-label": say("nav.plant") }, aboveRows(plantAlarms(), askingRows(rows)), rows.map((each) => {
    const { name, machine, row, alarms, level } = each, [said, worth] = sentence(row, name);
    return h("a", { class: `row ${level} ${row.valid}`, href: `#/machine/${encodeURIComponent(name)}`, "data-key": `${name} ${row.tag}`, "data-machine": name, "data-tag": row.tag },
      sign(level),
      h("span", { class: "what" }, h("b", {}, machine.label), h("span", {}, row.label), modeBadge(machine.mode, isCut(name))),
      figures(each),
      h("span", { class: "sentence" }, said, h("small", { class: "validity" }, worth), alarms.length > 0 && chips(alarms)),
      h("span", { class: "picture" }, pictureOf(each)));
  }));
}

// ---------------------------------------------------------------- the wall

const TILES = 4, TURN_S = 15;

// Four machines at a time, each by its worst temperature, to be read from across the room and without a hand: more of
// them take turns, and one that is in alarm does not wait for its turn: where the wall is full of alarms, these alone do.
export function wallView() {
  const rows = state.order.map((name) => temperatureRows().filter((each) => each.name === name).reduce((worst, each) => (rank(each) > rank(worst) ? each : worst)));
  const urgent = rows.filter(({ level }) => level === "alarm"), full = urgent.length >= TILES;
  const fixed = full ? [] : urgent, room = TILES - fixed.length;
  const rest = full ? urgent : rows.filter((each) => !fixed.includes(each)), turns = Math.max(Math.ceil(rest.length / room), 1);
  const begin = room * (Math.floor(performance.now() / 1000 / TURN_S) % turns);
  const shown = [...fixed, ...rest.slice(begin, begin + room)];
  shown.sort((a, b) => rows.indexOf(a) - rows.indexOf(b));
  return h("section", { class: "wallview" }, plantAlarms(), h("section", { class: `wall of${shown.length}` }, shown.map((each) => {
    const { name, machine, row, level, cut } = each;
    return h("section", { class: `tile ${level}`, "data-key": `${name} ${row.tag}` },
      h("h2", {}, sign(level), h("span", {}, machine.label), modeBadge(machine.mode, cut)),
      h("div", { class: "pair" }, h("p", {}, h("small", {}, row.label), h("b", { class: "big" }, value(row, name))), h("p", { class: `when ${row.valid}` }, h("small", {}, say("when.to", { limit: withUnit(number(row.limit, Number.isInteger(row.limit) ? 0 : 1), row.unit) })), h("b", { class: "amount" }, cut ? "–" : row.when[0]), h("small", {}, cut ? say("word.unknown") : row.when[1]))),
      h("p", {}, `${say("action.title")}: `, h("b", {}, cut ? say("word.unknown") : row.action)),
      h("div", { class: "picture" }, pictureOf(each)));
  })), rows.length > shown.length && h("p", { class: "turns" }, say("word.of", { shown: shown.length, count: rows.length })));
}
const rank = ({ level }) => Object.keys(SIGNS).indexOf(level);

// What stands of the whole plant is no machine's: a line of its own above them, and none without such an alarm.
function plantAlarms() {
  const own = state.order.flatMap((name) => state.machines[name].alarms.filter((alarm) => alarm.of_plant));
  if (!own.length) return null;
  return h("a", { class: "row whole", href: "#/alarms", "data-key": "plant" },
    h("span", { class: "what" }, h("b", {}, say("nav.plant"))),
    h("span", { class: "worst" }, own.map(chip)));
}

// The most urgent that stands and waits for somebody, else the most urgent; how many more there are.
const chips = (alarms) => [chip(alarms.find((alarm) => alarm.section === "standing" && waits(alarm)) ?? alarms[0]), alarms.length > 1 && h("span", { class: "chip over" }, `+ ${alarms.length - 1}`)];
const chip = (alarm) => h("span", { class: `chip ${alarm.level}` }, `${alarm.title} · ${say(`alarm.${stateKey(alarm.state)}`)}`);

export const stateKey = (text) => text.replaceAll(/[ -]/g, "_");

// ---------------------------------------------------------------- one machine

export function machineView(name, cut) {
  const machine = state.machines[name];
  if (!machine) return h("p", { class: "lead" }, `${name}: ${say("word.unknown")}`);
  const status = machine.status, extra = age(name) || 0;
  const cards = machine.temperatures.map((row) => temperatureCard(name, machine, row));
  const parts = h("section", { class: "machine" },
    h("div", { class: "head" },
      h("h2", {}, machine.label), badge(status.writeback),
      can("engineer") && status.writeback.mode !== "off" && h("button", { "data-act": status.writeback.mode === "armed" ? "disarm" : "arm", "data-machine": name }, say(status.writeback.mode === "armed" ? "person.disarm" : "person.arm"))),
    findings(machine, cut, extra),
    h("div", { class: "linkline" }, h("span", {}, say("word.link_hour")), strip(status), linkWord(status, cut),
      h("span", { class: "quiet" }, say("word.outages", { count: status.link.outage_count }))),
    cards,
    machine.alarms.some((alarm) => !alarm.of_plant) && h("section", { class: "card" }, h("h3", {}, say("nav.alarms")), alarmTable([name], false)),
    h("div", { class: "columns" },
      h("section", { class: "card" }, h("h3", {}, say("word.events")), eventList(status)),
      h("section", { class: "card wide" }, h("h3", {}, say("word.inputs")), inputs(machine, extra, cut))),
  );
  return [parts, () => machine.temperatures.forEach((row) => {
    const place = document.querySelector(`[data-chart="${CSS.escape(`${name} ${row.tag}`)}"]`);
    if (place && window.uPlot) fanChart(place, name, row, forecastOf(machine, row.tag).forecast);
  })];
}

// Whether the link is good now, of which nothing is known once the stream is cut.
export const linkWord = (status, cut) => cut
  ? h("span", { class: "quiet" }, say("word.unknown"))
  : h("span", { class: status.link.alive ? "" : "bad" }, say(status.link.alive ? "word.link_good" : "word.link_lost"));

function findings(machine, cut, extra) {
  if (!machine.findings.length) return h("p", { class: "well" }, cut ? say("live.before", { age: duration(extra), sentence: say("word.all_well") }) : say("word.all_well"));
  return h("ul", { class: "findings" }, machine.findings.map((each) =>
    h("li", {}, h("b", {}, say(`check.${stateKey(each.check)}`)), ": ", cut ? say("live.before", { age: duration(extra), sentence: each.sentence }) : each.sentence)));
}

// How long the plant has been in its state: since the event that brought it there, if that is among the newest.
function stay(status) {
  const events = status.recent_events, now = status.prediction?.location;
  let begun = null;
  for (let place = events.length - 1; place >= 0 && events[place][2] === now; place--) {
    begun = { time: events[place][0], whole: place > 0 };
  }
  if (!begun) return "";
  const seconds = Math.max(status.time - begun.time, 0) / status.speed;
  return begun.whole ? duration(seconds) : say("word.at_least", { age: duration(seconds) });
}


function temperatureCard(name, machine, row) {
  const one = forecastOf(machine, row.tag), status = machine.status, forecast = one.forecast, p = one.prediction;
  const present = row.value !== null && !isCut(name), usable = forecast && forecast.usable && present;
  const main = row.tag === status.temperature;
  return h("section", { class: `card temperature ${row.level}`, "data-key": row.tag },
    h("p", { class: "lead" }, sign(row.level), sentence(row, name)[0]),
    h("p", { class: `validity ${row.valid}` }, `${say("word.validity")}: ${sentence(row, name)[1]}`),
    h("dl", { class: "facts" },
      fact(explained("word.measured"), h("b", { class: "big" }, value(row, name)), h("small", {}, `${isCut(name) ? say("word.unknown") : qualityWord(row.quality)} · ${duration((row.age ?? 0) + (age(name) || 0))}`)),
      fact(explained("word.limit"), withUnit(number(row.limit), row.unit)),
      p && fact(explained("word.predicted"), present ? withUnit(number(p.mean), row.unit) : "–", present && h("small", {}, `${say("word.band")} ${number(p.low)}\u00a0–\u00a0${number(p.high)}`)),
      p && fact(explained("word.state"), present && p.known ? p.location : say("word.unknown"), h("small", {}, main && present && p.known && stay(status) && `${say("word.for")} ${stay(status)}`)),
      p && fact(explained("word.confidence"), h("span", { class: `zone ${present ? row.confidence.zone : ""}` }, present ? row.confidence.word : "–")),
      row.familiarity && fact(explained("familiarity.title", "familiarity"), h("span", { class: `zone ${present ? row.familiarity.zone : ""}` }, present ? row.familiarity.word : "–"), present && h("small", {}, [row.familiarity.sentence, row.familiarity.detail].filter(Boolean).join(" · "))),
      forecast && fact(explained("word.minutes_to_limit"), usable ? row.to_limit.median : "–", usable && row.to_limit.band && h("small", {}, row.to_limit.band)),
      forecast && fact(explained("word.p_limit"), forecast.horizons.map((horizon, place) => h("div", {}, `${say("word.in_minutes", { minutes: number(horizon / 60, 0) })}: ${usable ? `${number(100 * forecast.p_limit[place], 0)} %` : "–"}`))),
      forecast && fact(explained("word.coverage"), row.confidence ? row.confidence.coverage : "–"),
    ),
    h("div", { class: "chart", "data-keep": "", "data-key": `${name} ${row.tag}`, "data-chart": `${name} ${row.tag}`, role: "img", "aria-label": row.sentence }));
}

const qualityWord = (code) => (code ? say(`quality.${code.toLowerCase()}`) : "");

function eventList(status) {
  if (!status.recent_events.length) return h("p", { class: "quiet" }, say("word.none"));
  return h("ol", { class: "events" }, status.recent_events.slice(-8).reverse().map(([time, symbol, where]) =>
    h("li", {}, h("time", {}, clock(time)), h("b", {}, symbol), h("span", {}, where))));
}

// A tag in the plant's words where there are any, its own name beside them.
const tagHead = (labels, name) => h("th", { scope: "row" }, labels[name] ? [labels[name], h("small", {}, name)] : name);

// A number stays in one line; a PLC's text, or a unit of many letters, is broken: what is right of it would be out of sight.
const MOST_IN_A_LINE = 24;
const valueCell = (text, cut) => h("td", { class: text.length > MOST_IN_A_LINE ? null : "number" }, cut ? h("span", { class: "old" }, say("live.was", { value: text })) : text);

// What a driver says and this language has no words for is English, and marked as such.
export const english = (text) => (text.endsWith(" (en)") ? "en" : null);
const reasonCell = (text) => h("td", { class: "reason", lang: english(text) }, text);

function inputs({ status, labels, reasons }, extra, cut) {
  const rank = (tag) => (tag.quality === "GOOD" ? 1 : 0);
  const rows = Object.entries(status.values).sort(([, a], [, b]) => rank(a) - rank(b));
  return h("div", { class: "scroll", tabindex: "0" }, h("table", { class: "stacks readings" },
    h("thead", {}, h("tr", {}, ["tag", "value", "age", "quality", "reason"].map((key) => h("th", { scope: "col", class: key === "value" || key === "age" ? "number" : null }, say(`word.${key}`))))),
    h("tbody", {}, rows.map(([name, tag]) => h("tr", { class: tag.quality === "GOOD" ? "" : "bad" },
      tagHead(labels, name),
      valueCell(withUnit(shown(tag.value), unit(tag.unit)), cut),
      h("td", { class: "number", "data-head": say("word.age") }, duration(tag.age / status.speed + extra)),
      h("td", { "data-head": say("word.quality") }, cut ? say("word.unknown") : qualityWord(tag.quality)), reasonCell(reasons[name] ?? ""))))));
}
