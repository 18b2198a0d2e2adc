// Alarms and the scorecard.
import { ask, byWhom, duration, explained, fact, grid, h, moment, number, person, say, shown, start, withUnit } from "./dom.js";
import { state } from "./live.js";
import { scoreOf } from "./scores.js";
import { sign, stateKey, worstLevel } from "./plant.js";
import { sounds } from "./sound.js";

const ROLES = ["operator", "engineer", "administrator"];
export const can = (role) => ROLES.indexOf(person.role) >= ROLES.indexOf(role);

// What was, in the reader's language, with what it watched in the plant's words; its own name where nobody knows its kind.
export function pastTitle({ kind, condition, tag, of_plant }, labels, tense = "past") {
  if (!kind) return condition;
  const what = condition === kind || of_plant ? "" : (labels[tag] ?? tag);
  const said = say(`${tense}.${stateKey(kind)}`);
  return what ? `${what}: ${said}` : said;
}

export const waits = (alarm) => alarm.state === "unacknowledged" || alarm.state.endsWith(" unacknowledged");

// The alarms of some machines: what stands, then what is over, then what was put aside, the most urgent first. What
// tells of one cause is one row, with its parts below it. The plant's are shown too, which one of them looks after.
const SECTIONS = ["standing", "over", "aside"];
export function alarmTable(names, ofPlant = true) {
  const rows = names.flatMap((name) => state.machines[name].alarms.filter((alarm) => ofPlant || !alarm.of_plant)
    .map((alarm) => ({ ...alarm, machine: name, status: state.machines[name].status })));
  rows.sort((a, b) => a.priority - b.priority || b.since - a.since);
  if (!rows.length) return h("p", { class: "quiet" }, say("alarm.none"));
  const entryOf = (row) => entry(row, rows.filter((each) => each.machine === row.machine && each.under === row.name));
  // Of a flood the most urgent and what came first is shown; what is folded away is not acknowledged with it.
  const fresh = rows.filter(announcedLately).length, flood = fresh > start.flood.count;
  const folded = flood ? rows.filter((row) => row.section === "standing" && !row.under && row.priority > 1 && !row.first_up) : [];
  const waiting = rows.filter((row) => waits(row) && !folded.some((head) => head.machine === row.machine && [row.name, row.under].includes(head.name)));
  return [
    flood && h("div", { class: "flood", role: "status", "data-key": "flood" }, h("b", {}, say("alarm.flood", { count: fresh })), h("span", {}, say("alarm.flood_shown"))),
    waiting.length > 1 && can("operator") && h("p", { class: "buttons", "data-key": "all" }, acknowledging(waiting, say("alarm.acknowledge_all", { count: waiting.length }))),
    SECTIONS.map((section) => {
      const heads = rows.filter((row) => row.section === section && !row.under && !folded.includes(row));
      return heads.length > 0 && [h("h3", { "data-key": `${section} head` }, say(`alarm.${section}`)), h("ul", { class: "alarms", "data-key": section }, heads.map(entryOf))];
    }),
    [...new Set(folded.map((row) => row.of))].map((of) => {
      const heads = folded.filter((row) => row.of === of);
      return h("details", { class: "folded", "data-key": of }, h("summary", {}, say("alarm.folded", { of, count: heads.length })), h("ul", { class: "alarms" }, heads.map(entryOf)));
    })];
}
const announcedLately = (row) => row.raised !== null && row.status.time - row.raised <= start.flood.span_s;

// What is acknowledged is what was shown when the button was pressed, and nothing that came since.
const acknowledging = (rows, text) => h("button", { class: "main", "data-act": "acknowledge", "data-shown": JSON.stringify(rows.map((row) => [row.machine, row.name])) }, text);

function entry(row, parts) {
  const level = worstLevel([row, ...parts]), waiting = [row, ...parts].filter(waits);
  return h("li", { class: `entry ${level}`, "data-key": `${row.of} ${row.name}`, "data-alarm": row.name },
    sign(level),
    h("div", { class: "alarmtext" }, h("b", { title: row.name }, `${row.of}: ${row.title}`, firstUp(row)), told(row), facts(row),
      parts.length > 0 && h("ul", { class: "parts" }, parts.map((part) => h("li", { "data-part": part.name }, h("b", { title: part.name }, part.title, firstUp(part)), told(part), facts(part), h("div", { class: "changes" }, changes(part)))))),
    h("div", { class: "buttons" }, waiting.length > 0 && can("operator") && acknowledging(waiting, say("change.acknowledge")), changes(row)));
}

const firstUp = (row) => row.first_up && row.section === "standing" && h("span", { class: "first", title: say("alarm.first_up_means") }, say("alarm.first_up"));

// What to do, and what comes if nobody does it.
const told = (row) => [h("span", { class: "response" }, row.sentence), row.otherwise && h("span", { class: "otherwise" }, say("alarm.otherwise", { text: row.otherwise }))];

const facts = (row) => h("small", {}, `${say("alarm.priority")} ${row.priority} · ${say(`alarm.${stateKey(row.state)}`)} · ${say(row.section === "over" ? "alarm.over_since" : "word.since")} ${moment(row.since)} (${duration((row.status.time - row.since) / row.status.speed)})`,
  row.acknowledged_by && ` · ${say("alarm.acknowledged_by")} ${byWhom(row.acknowledged_by)}`,
  row.until && ` · ${say("alarm.until", { until: moment(row.until), by: byWhom(row.by), reason: row.reason })}`);

const changes = (row) => row.possible.filter((change) => change !== "acknowledge" && can(change.includes("service") ? "engineer" : "operator")).map((change) =>
  h("button", { "data-act": "alarm", "data-change": change, "data-machine": row.status.machine, "data-of": row.name }, say(`change.${stateKey(change)}`)));

// How many alarms there are against what a person can deal with; the sentences are the gateway's.
function ratesFacts(rates) {
  if (!rates) return null;
  const facts = [["announced", rates.announced], ["average", `${number(rates.per_ten_minutes, 2)}`], ["peak", rates.peak], ["floods", rates.floods.length], ["chattering", Object.keys(rates.chattering).length], ["stale", Object.keys(rates.stale).length]];
  return [h("h2", {}, say("alarm.rates")),
    h("dl", { class: "facts" }, facts.map(([key, found]) => fact(explained(`rates.${key}`), h("b", {}, String(found))))),
    rates.findings.length ? h("ul", {}, rates.findings.map((each) => h("li", {}, each))) : h("p", { class: "quiet" }, say("rates.ok"))];
}

let history = { key: "", rows: null, rates: null };
export function alarmsView() {
  // Asked anew whenever an alarm has moved.
  const key = state.order.map((name) => JSON.stringify(state.machines[name].status.alarms)).join();
  if (history.key !== key) {
    history = { ...history, key };
    ask("GET", "/api/rates", { days: 7 }).then(({ rates }) => (history.rates = rates), () => {});
    Promise.all(state.order.map((name) => ask("GET", "/api/alarms", { machine: name, most: 100 }).then(({ rows }) => rows.map((row) => ({ name, ...row })), () => [])))
      .then((all) => (history.rows = all.flat().sort((a, b) => b.time - a.time).slice(0, 200)));
  }
  return h("section", { class: "view" },
    h("div", { class: "head" }, h("h2", {}, say("nav.alarms")), h("button", { "data-act": "sound", "aria-pressed": String(sounds()) }, say("alarm.sound"))), alarmTable(state.order),
    ratesFacts(history.rates),
    h("h2", {}, say("alarm.history")),
    !history.rows ? h("p", { class: "quiet" }, say("word.loading")) : !history.rows.length ? h("p", { class: "quiet" }, say("word.nothing"))
      : grid([say("word.time"), say("word.machine"), say("alarm.alarm"), say("word.state"), say("word.value"), say("alarm.acknowledged_by")],
        history.rows.map((row) => [moment(row.time), row.of_plant ? say("nav.plant") : state.machines[row.name]?.label ?? row.name, h("span", { title: row.condition }, pastTitle(row, state.machines[row.name]?.labels ?? {})), say(`alarm.${stateKey(row.state)}`), shown(row.value), byWhom(row.acknowledged_by)])));
}

export function scorecardView() {
  return h("section", { class: "view" }, state.order.flatMap((name) => state.machines[name].temperatures.filter((row) => row.predicted).map((row) => {
    const { weeks, error } = scoreOf(name, row.tag);
    return h("section", { class: "card" }, h("h2", {}, `${state.machines[name].label}: ${row.label}`),
      error ? h("p", { class: "quiet" }, error) : !weeks ? h("p", { class: "quiet" }, say("word.loading"))
        : weeks.length ? [...weeks.map((week) => scores(week, row.unit)), h("p", { class: "quiet" }, say("score.heeded"))] : h("p", { class: "quiet" }, say("word.nothing")));
  })));
}

function scores({ start, end, card, warnings }, unit) {
  const better = (own, other) => (own === null || !other ? "–"
    : say(own > other ? "score.worse" : "score.better", { percent: number(Math.abs(100 * (1 - own / other)), 0) }));
  const blocks = Object.entries(card.writes.verdicts);
  return h("div", {}, h("h3", {}, `${moment(start).slice(0, 10)} – ${moment(end).slice(0, 10)}`),
    h("dl", { class: "facts" }, [["hits", warnings.hits], ["misses", warnings.misses], ["false_alarms", warnings.false_alarms], ["lead", duration(warnings.lead)]]
      .map(([key, found]) => fact(explained(`score.${key}`), h("b", {}, String(found))))),
    grid([say("score.horizon"), say("score.error"), say("score.persistence"), say("score.against"), say("word.coverage"), say("score.count")],
      card.forecasts.map(({ horizon, count, mae, persistence_mae, coverage90 }) => [withUnit(number(horizon / 60, 0), "min"),
        ...(count ? [withUnit(number(mae, 2), unit), withUnit(number(persistence_mae, 2), unit), better(mae, persistence_mae), `${number(100 * coverage90, 0)} %`] : ["–", "–", "–", "–"]), count])),
    h("dl", { class: "facts" },
      [["score.one_step", card.one_step], ["score.free_run", card.free_run]].map(([key, error]) => fact(explained(key), error.count ? withUnit(number(error.mae, 2), unit) : "–")),
      blocks.length > 0 && fact(say("score.blocks"), blocks.map(([verdict, count]) => h("div", {}, `${say(`verdict.${stateKey(verdict)}`)}: ${count}`)))));
}
