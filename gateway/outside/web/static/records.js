// Alarms and the scorecard.
import { ask, duration, h, moment, number, person, say, shown } from "./dom.js";
import { state } from "./live.js";
import { scoreOf } from "./scores.js";
import { sign, stateKey } from "./plant.js";

const ROLES = ["operator", "engineer", "administrator"];
export const can = (role) => ROLES.indexOf(person.role) >= ROLES.indexOf(role);

// An alarm in the reader's language, with what it watches in the plant's words; its own name where nobody knows its kind.
export function alarmTitle({ kind, name, tag, of_plant }, labels) {
  if (!kind) return name;
  const what = name === kind || of_plant ? "" : (labels[tag] ?? tag);
  return what ? `${what}: ${say(`kind.${stateKey(kind)}`)}` : say(`kind.${stateKey(kind)}`);
}

// The alarms of some machines that are not normal, the most urgent first; the plant's too, which one of them looks after.
export function alarmTable(names, ofPlant = true) {
  const rows = names.flatMap((name) => state.machines[name].alarms.filter((alarm) => ofPlant || !alarm.of_plant).map((alarm) => ({ name, machine: state.machines[name], ...alarm, alarm: alarm.name })));
  rows.sort((a, b) => a.priority - b.priority || b.since - a.since);
  if (!rows.length) return h("p", { class: "quiet" }, say("alarm.none"));
  return h("ul", { class: "alarms" }, rows.map((row) => {
    const alarm = row.alarm, possible = row.possible?.length ? row.possible : row.state.includes("unacknowledged") ? ["acknowledge"] : [];
    return h("li", { class: `entry ${row.level}`, "data-key": `${row.of} ${alarm}`, "data-alarm": alarm },
      sign(row.level),
      h("div", { class: "alarmtext" }, h("b", { title: alarm }, `${row.of}: ${alarmTitle({ ...row, name: alarm }, row.machine.labels)}`), h("span", { class: "response" }, row.response),
        h("small", {}, `${say("alarm.priority")} ${row.priority} · ${say(`alarm.${stateKey(row.state)}`)} · ${say("word.since")} ${moment(row.since)} (${duration((row.machine.status.time - row.since) / row.machine.status.speed)})`,
          row.acknowledged_by && ` · ${say("alarm.acknowledged_by")} ${row.acknowledged_by}`,
          row.until && ` · ${say("alarm.until", { until: moment(row.until), by: row.by, reason: row.reason })}`)),
      h("div", { class: "buttons" }, possible.filter((change) => can(change.includes("service") ? "engineer" : "operator")).map((change) =>
        h("button", { "data-act": "alarm", "data-change": change, "data-machine": row.machine.status.machine, "data-of": alarm, class: change === "acknowledge" ? "main" : null }, say(`change.${stateKey(change)}`)))));
  }));
}

// How many alarms there are against what a person can deal with; the sentences are the gateway's.
function ratesFacts(rates) {
  if (!rates) return null;
  const facts = [["announced", rates.announced], ["average", `${number(rates.per_ten_minutes, 2)}`], ["peak", rates.peak], ["floods", rates.floods.length], ["chattering", Object.keys(rates.chattering).length], ["stale", Object.keys(rates.stale).length]];
  return [h("h2", {}, say("alarm.rates")),
    h("dl", { class: "facts" }, facts.map(([key, found]) => h("div", { class: "fact" }, h("dt", {}, say(`rates.${key}`)), h("dd", {}, h("b", {}, String(found)))))),
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
    h("h2", {}, say("alarm.standing")), alarmTable(state.order),
    ratesFacts(history.rates),
    h("h2", {}, say("alarm.history")),
    !history.rows ? h("p", { class: "quiet" }, say("word.loading")) : !history.rows.length ? h("p", { class: "quiet" }, say("word.nothing"))
      : h("div", { class: "scroll", tabindex: "0" }, h("table", {},
        h("thead", {}, h("tr", {}, [say("word.time"), say("word.machine"), say("alarm.alarm"), say("word.state"), say("word.value"), say("alarm.acknowledged_by")].map((text) => h("th", { scope: "col" }, text)))),
        h("tbody", {}, history.rows.map((row) => h("tr", {}, h("td", {}, moment(row.time)), h("td", {}, row.of_plant ? say("nav.plant") : state.machines[row.name]?.label ?? row.name), h("th", { scope: "row", title: row.condition }, alarmTitle({ ...row, name: row.condition }, state.machines[row.name]?.labels ?? {})),
          h("td", {}, say(`alarm.${stateKey(row.state)}`)), h("td", { class: "number" }, shown(row.value)), h("td", {}, row.acknowledged_by)))))));
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
  const better = (own, other) => (own === null || !other ? "–" : `${number(100 * (1 - own / other), 0)} %`);
  const blocks = Object.entries(card.writes.verdicts);
  return h("div", {}, h("h3", {}, `${moment(start).slice(0, 10)} – ${moment(end).slice(0, 10)}`),
    h("dl", { class: "facts" }, [["hits", warnings.hits], ["misses", warnings.misses], ["false_alarms", warnings.false_alarms], ["lead", duration(warnings.lead)]]
      .map(([key, found]) => h("div", { class: "fact" }, h("dt", {}, say(`score.${key}`)), h("dd", {}, h("b", {}, String(found)))))),
    h("div", { class: "scroll", tabindex: "0" }, h("table", {},
      h("thead", {}, h("tr", {}, [say("score.horizon"), say("score.error"), say("score.persistence"), say("score.better"), say("word.coverage"), say("score.count")].map((text, place) => h("th", { scope: "col", class: place ? "number" : null }, text)))),
      h("tbody", {}, card.forecasts.map((each) => h("tr", {}, h("th", { scope: "row" }, `${number(each.horizon / 60, 0)} min`),
        h("td", { class: "number" }, each.count ? `${number(each.mae, 2)} ${unit}` : "–"), h("td", { class: "number" }, each.count ? `${number(each.persistence_mae, 2)} ${unit}` : "–"),
        h("td", { class: "number" }, each.count ? better(each.mae, each.persistence_mae) : "–"), h("td", { class: "number" }, each.count ? `${number(100 * each.coverage90, 0)} %` : "–"), h("td", { class: "number" }, each.count)))))),
    h("dl", { class: "facts" },
      [["score.one_step", card.one_step], ["score.free_run", card.free_run]].map(([key, error]) => h("div", { class: "fact" }, h("dt", {}, say(key)), h("dd", {}, error.count ? `${number(error.mae, 2)} ${unit}` : "–"))),
      blocks.length > 0 && h("div", { class: "fact" }, h("dt", {}, say("score.blocks")), h("dd", {}, blocks.map(([verdict, count]) => h("div", {}, `${verdict}: ${count}`))))));
}
