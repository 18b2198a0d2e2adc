// What is inside: the model, the links, the computer.
import { ask, bytes, clock, duration, explained, fact, grid, h, moment, number, s, say, shown, withUnit } from "./dom.js";
import { isCut, state } from "./live.js";
import { badge, english, linkWord } from "./plant.js";
import { can } from "./records.js";
import { strip } from "./draw.js";
import { scoreOf } from "./scores.js";

// ---------------------------------------------------------------- the model

const models = new Map(); // machine -> {key, temperatures}
export function modelView() {
  return h("section", { class: "view" }, state.order.flatMap((name) => {
    const { status, label, temperatures } = state.machines[name];
    const key = JSON.stringify([status.model, status.further.map((one) => one.model)]);
    if (models.get(name)?.key !== key) {
      models.set(name, { key });
      ask("GET", "/api/model", { machine: name }).then((found) => models.set(name, { key, ...found }), (error) => models.set(name, { key, error: error.message }));
    }
    const known = models.get(name);
    return temperatures.map((row) => h("section", { class: "card", "data-key": `${name} ${row.tag}` }, h("h2", {}, `${label}: ${row.label}`),
      known.error ? h("p", { class: "error" }, known.error) : !known.temperatures ? h("p", { class: "quiet" }, say("word.loading"))
        : [versionList(known.temperatures[row.tag], name, row.tag), modelCard(known.temperatures[row.tag], row.unit, row.predicted && scoreOf(name, row.tag).weeks?.[0]?.card, [status, ...status.further].find((one) => one.temperature === row.tag)?.prediction)]));
  }));
}

// The versions of the store, the newest first; a person may have another one run than the one that does.
const NEWEST = 6;
function versionList(model, machine, temperature) {
  if (!model?.versions.length) return null;
  const { versions, version: runs } = model;
  return h("ul", { class: "versions" }, [...versions].reverse().slice(0, NEWEST).map((version) => h("li", {}, h("code", {}, version), " ",
    version === runs ? h("span", { class: "key present" }, say("model.runs"))
      : can("engineer") && h("button", { "data-act": "promote", "data-machine": machine, "data-of": temperature, "data-version": version, "data-runs": runs },
        say(versions.indexOf(version) < versions.indexOf(runs) ? "model.back" : "model.promote")),
    verdictText(model.verdicts[version]), originText(model.origins[version]), findingText(model.findings[version]))));
}

const originText = (origin) => origin && h("small", {}, `${say("model.written")} ${moment(origin.written)} · ${say("model.method")} ${origin.method}`,
  origin.traces > 0 && ` · ${say("model.traces_count", { count: origin.traces })}`, origin.synthetic && ` · ${say("model.synthetic")}`);

// Whether a version may be used, as it was judged where it was learned; the figures behind it in its own words.
function verdictText(verdict) {
  return verdict && h("small", { class: `verdict ${verdict.word.replace(" ", "-")}`, title: verdict.sentence }, " ", say(`judged.${verdict.word.replace(" ", "_")}`), verdict.score && `: ${verdict.score}`);
}

// What a diagnosis found missing, and the experiment that would confirm it, beside the version that has it.
function findingText(finding) {
  if (!finding) return null;
  const told = (key, own) => (say(key) === key ? own : say(key)); // an engineer's own effect has words of its own
  return h("div", { class: "finding" }, h("small", {}, say("model.found", { before: number(finding.before, 2), after: number(finding.after, 2), unit: finding.unit.replace("degC", "°C") })),
    h("ul", {}, finding.effects.map((each) => h("li", {}, told(`effect.${each.name}`, each.plain), each.members.length > 1 && ` (${say("model.or")} ${each.members.slice(1).map((other) => told(`effect.${other}`, other)).join("; ")})`,
      h("br"), h("small", {}, `${say("model.confirm")}: ${told(`experiment.${each.name}`, each.experiment)}`)))));
}

function modelCard(model, unit, card, prediction) {
  if (!model) return h("p", { class: "quiet" }, say("model.none"));
  const from = model.provenance, present = prediction?.known ? prediction.location : null;
  return h("div", {},
    model.refused && h("p", { class: "error" }, `${say("model.refused")}: ${model.refused}`),
    model.verdict && h("p", {}, h("span", { class: `verdict ${model.verdict.replace(" ", "-")}` }, say(`judged.${model.verdict.replace(" ", "_")}`)), " ", h("small", {}, model.verdict_sentence.replace(`${model.verdict}: `, ""))),
    criteriaList(model),
    h("dl", { class: "facts" },
      fact(say("model.runs"), model.name), fact(say("model.hash"), h("code", {}, model.hash.slice(0, 12))), model.version && fact(say("model.version"), model.version),
      model.written && fact(say("model.written"), moment(model.written)), fact(say("model.method"), from.method),
      from.traces.length > 0 && fact(say("model.traces"), from.traces.slice(0, 6).join(", ") + (from.traces.length > 6 ? " …" : ""), from.synthetic && h("small", {}, say("model.synthetic")))),
    h("h3", {}, say("model.automaton")),
    h("p", { class: "quiet" }, say("model.locations", { locations: model.locations.length, edges: movesOf(model).length }), " · ", h("span", { class: "key present" }, present ?? say("word.unknown")), ` ${say("model.present")}`),
    shareChoice(model), automaton(model, present), stateTable(model, unit, present, card?.by_location), startTable(card, unit));
}

// Of many moves those are drawn that are taken often; where the model does not know how often, all.
const SHARES = [0, 0.05, 0.1, 0.25];
let least = 0.1;
const movesOf = (model) => model.edges.filter((edge) => edge.source !== edge.target); // an event that leaves the state is none
const taken = (model) => movesOf(model).filter((edge) => edge.share === null || edge.share >= least);
addEventListener("change", ({ target }) => {
  if (target.dataset?.share === undefined) return;
  least = Number(target.value);
  dispatchEvent(new HashChangeEvent("hashchange"));
});
function shareChoice(model) {
  const moves = movesOf(model);
  return moves.some((edge) => edge.share !== null) && h("div", { class: "controls" }, h("label", {}, h("span", {}, say("model.least")),
    h("select", { "data-share": "" }, SHARES.map((share) => h("option", { value: share, selected: share === least }, share ? `${number(100 * share, 0)} %` : say("model.all"))))),
  h("span", { class: "quiet" }, say("model.drawn", { count: taken(model).length, all: moves.length })));
}

// Each state with where it leads to, and how far the model was off while in it; the same in words as the picture has it.
function stateTable(model, unit, present, errors) {
  const next = (place) => taken(model).filter((edge) => edge.source === place.name && edge.share !== null).sort((a, b) => b.share - a.share)
    .map((edge) => `${edge.target} ${number(100 * edge.share, 0)} %`).join(", ");
  const off = (place) => (errors?.[place.name]?.count ? `${withUnit(number(errors[place.name].mae, 2), unit)} (${errors[place.name].count})` : "–");
  return grid([say("word.state"), say("model.target"), say("model.time_constant"), say("model.stay"), explained("model.error"), say("model.next")], model.locations.map((place) => [
    place.name === present ? h("span", { class: "key present" }, place.name) : place.name,
    place.target === null ? "–" : withUnit(number(place.target), unit), duration(place.time_constant), duration(place.stay), off(place), next(place)]));
}

// How right the forecasts of the last week were by how long the machine had been running when they were made.
function startTable(card, unit) {
  if (!card?.by_start.length) return null;
  const horizons = card.forecasts.map((one) => one.horizon), minutes = (seconds) => number(seconds / 60, 0);
  const from = ({ begin, end }) => (begin === null ? say("model.resting") : end === null ? say("model.after_start", { from: minutes(begin) }) : say("model.between_start", { from: minutes(begin), to: minutes(end) }));
  const cell = (one) => (one?.count ? [withUnit(number(one.mae, 2), unit), h("small", {}, say("model.of_forecasts", { percent: number(100 * one.coverage90, 0), count: one.count }))] : "–");
  return [h("h3", {}, say("model.by_start")), h("p", { class: "quiet" }, say("help.by_start")), grid([say("model.since_start"), ...horizons.map((each) => say("word.in_minutes", { minutes: minutes(each) }))],
    card.by_start.map((row) => [from(row), ...horizons.map((each) => cell(row.forecasts.find((one) => one.horizon === each)))]))];
}

// What a model was judged by where it was learned, in the judge's own words.
function criteriaList(model) {
  if (!model.criteria.length) return null;
  return h("details", {}, h("summary", {}, say("model.criteria", { count: model.criteria.length })), h("ul", {}, model.criteria.map((one) =>
    h("li", { class: "criterion" }, h("b", {}, one.kept === null ? "?" : one.kept ? "✓" : "✗", h("span", { class: "hidden" }, say(one.kept === null ? "word.unknown" : one.kept ? "word.yes" : "word.no"))), ` ${one.criterion}: ${one.sentence}`,
      one.next_step && h("small", {}, one.next_step)))));
}

// Where the machine runs lies above where it may and where it rests; what is to the right has the greater load, or leads
// to the higher temperature where the model tells no loads apart. States of one place stand below one another.
const ROWS = [true, null, false], STEP_X = 150, STEP_Y = 96, EDGE = 70;
function layOut(locations) {
  const levels = new Set(locations.map((place) => place.load).filter((load) => load !== null));
  const worth = (place) => (levels.size > 1 ? place.load : place.target) ?? -Infinity;
  const columns = [...new Set(locations.map(worth))].sort((a, b) => a - b);
  const rows = ROWS.filter((runs) => locations.some((place) => place.runs === runs));
  const at = {}, heads = [];
  let top = EDGE;
  for (const runs of rows) {
    const used = columns.map(() => 0);
    for (const place of locations.filter((each) => each.runs === runs)) {
      const column = columns.indexOf(worth(place));
      // Every other column a little lower: a move along a row does not run through the states between.
      at[place.name] = { x: EDGE + 60 + column * STEP_X, y: top + used[column]++ * STEP_Y + (column % 2) * 30 };
    }
    heads.push({ runs, y: top });
    top += Math.max(...used) * STEP_Y + 50;
  }
  return { at, heads, width: 2 * EDGE + 60 + (columns.length - 1) * STEP_X, height: top, byLoad: levels.size > 1 };
}

// Moves are arcs that keep to their right, so that there and back are two lines, the wider the more often they are taken.
const BENDS = [0.16, 0.3, 0.45, 0.6], CLEARANCE = 26, COURSE = Array.from({ length: 19 }, (_, place) => (place + 1) / 20);
function automaton(model, present) {
  const few = model.locations.length <= 8, { at, heads, width, height, byLoad } = layOut(model.locations);
  const moves = taken(model).map((edge) => {
    const a = at[edge.source], b = at[edge.target], dx = b.x - a.x, dy = b.y - a.y, length = Math.hypot(dx, dy) || 1;
    // The least bend by which it runs through no other state.
    const across = (share) => [(a.x + b.x) / 2 + dy * share, (a.y + b.y) / 2 - dx * share], others = Object.values(at).filter((each) => each !== a && each !== b);
    const clear = ([x, y]) => others.every((each) => COURSE.every((t) => Math.hypot((1 - t) ** 2 * a.x + 2 * t * (1 - t) * x + t ** 2 * b.x - each.x, (1 - t) ** 2 * a.y + 2 * t * (1 - t) * y + t ** 2 * b.y - each.y) > CLEARANCE));
    const [cx, cy] = across(BENDS.find((share) => clear(across(share))) ?? BENDS[0]);
    const near = (from, to, by) => { const l = Math.hypot(to.x - from.x, to.y - from.y) || 1; return [from.x + ((to.x - from.x) / l) * by, from.y + ((to.y - from.y) / l) * by]; };
    const [x1, y1] = near(a, { x: cx, y: cy }, 24), [x2, y2] = near(b, { x: cx, y: cy }, 30);
    const here = edge.source === present, often = edge.share === null ? "" : ` (${number(100 * edge.share, 0)} %)`;
    return s("g", { class: `move${here ? " here" : ""}` }, s("path", { d: `M${x1.toFixed(1)} ${y1.toFixed(1)} Q${cx.toFixed(1)} ${cy.toFixed(1)} ${x2.toFixed(1)} ${y2.toFixed(1)}`, "stroke-width": (1 + 3 * (edge.share ?? 0.2)).toFixed(1), "marker-end": "url(#tip)" }, s("title", {}, `${edge.source} → ${edge.target}: ${edge.symbols.join(", ")}${often}`)),
      few && s("text", { x: ((x1 + 2 * cx + x2) / 4).toFixed(1), y: ((y1 + 2 * cy + y2) / 4).toFixed(1) }, edge.symbols.slice(0, 2).join(", ") + (edge.symbols.length > 2 ? " …" : "")));
  });
  const places = model.locations.map((place) => {
    const { x, y } = at[place.name];
    return s("g", { class: `place${place.name === present ? " present" : ""}${place.borrowed ? " borrowed" : ""}` },
      s("circle", { cx: x, cy: y, r: 22 }), place.target !== null && s("text", { class: "goal", x, y: y + 4 }, number(place.target, 0)),
      s("text", { x, y: y + 38 }, place.name), s("title", {}, `${place.name} (${place.flow})${place.borrowed ? `, ${say("model.borrowed")}` : ""}`));
  });
  const words = new Map([[true, "model.running"], [null, "model.either"], [false, "model.resting"]]);
  return h("div", { class: `scroll automaton${width <= 560 ? " small" : ""}`, tabindex: "0" }, s("svg", { viewBox: `0 0 ${width} ${height}`, width, height, role: "img", "aria-label": `${say("model.automaton")}: ${say("model.present")} ${present ?? say("word.unknown")}` },
    s("defs", {}, s("marker", { id: "tip", viewBox: "0 0 8 8", refX: 6, refY: 4, markerWidth: 9, markerHeight: 9, markerUnits: "userSpaceOnUse", orient: "auto" }, s("path", { d: "M0 0 L8 4 L0 8 z" }))),
    heads.length > 1 && heads.map(({ runs, y }) => s("text", { class: "side", x: 6, y: y + 4 }, say(words.get(runs)))),
    s("text", { class: "side", x: 6, y: height - 8 }, `${say(byLoad ? "model.by_load" : "model.by_target")} →`), moves, places));
}

// ---------------------------------------------------------------- the links

// A driver of an engineer's own has counters of its own.
const counterName = (key) => (say(`counter.${key}`) === `counter.${key}` ? key.replaceAll("_", " ") : say(`counter.${key}`));

export function communicationView() {
  return h("section", { class: "view" }, state.order.map((name) => {
    const { status, label, link_reason, link_reasons } = state.machines[name];
    const outages = [...status.link.outages].reverse().slice(0, 10);
    return h("section", { class: "card", "data-key": name }, h("h2", {}, label),
      h("div", { class: "linkline" }, h("span", {}, say("word.link_hour")), strip(status), linkWord(status, isCut(name))),
      link_reason && h("p", { class: "error" }, link_reason),
      h("dl", { class: "facts" }, fact(say("link.scans"), status.scan.count), fact(say("link.missed"), status.scan.missed), fact(say("link.period"), `${number(status.scan.period, 1)} s`)),
      h("p", {}, `${say("word.writeback")}: `, badge(status.writeback)),
      grid([say("word.link"), say("link.place"), say("link.active"), say("link.connected"), say("word.reason")], status.links.map((link, place) => [link.name, link.place, shown(link.active), shown(link.connected), link_reasons[place] ? h("span", { lang: english(link_reasons[place]) }, link_reasons[place]) : ""])),
      outages.length > 0 && [h("h3", {}, say("link.outages")), grid([say("link.begin"), say("link.end")], outages.map((each) => [clock(each.last_good), each.recovered_s === null ? say("link.lasts") : duration(each.recovered_s)]))],
      Object.keys(status.driver).length > 0 && [h("h3", {}, say("link.counters")), grid([say("word.name"), say("word.count")], Object.entries(status.driver).map(([key, count]) => [counterName(key), shown(count)]))],
      Object.keys(status.writeback).includes("written") && grid([say("word.writeback"), say("word.count")], ["written", "accepted", "refused", "failed"].filter((key) => key in status.writeback).map((key) => [counterName(key), shown(status.writeback[key])])));
  }));
}

// ---------------------------------------------------------------- the computer

let box = { asked: -Infinity, facts: null };
export function boxView() {
  if (performance.now() - box.asked > 5000 && !isCut()) {
    box.asked = performance.now();
    ask("GET", "/api/box").then((facts) => (box.facts = facts), () => {});
  }
  const { status } = state.machines[state.order[0]], f = box.facts, historian = status.historian;
  const share = (part, whole) => (part === null || !whole ? "" : ` (${number((100 * part) / whole, 0)} %)`);
  const lost = historian.dropped + historian.refused;
  const parts = state.order.flatMap((name) => Object.entries(state.machines[name].status.parts).map(([part, how]) => [state.order.length > 1 ? `${state.machines[name].label}: ${part}` : part, how]));
  return h("section", { class: "view" },
    h("section", { class: "card" }, h("h2", {}, say("nav.box")), h("dl", { class: "facts" },
      f && [fact(say("box.disk"), bytes(f.disk.free), h("small", {}, share(f.disk.free, f.disk.total))), fact(say("box.memory"), bytes(f.memory.available), h("small", {}, share(f.memory.available, f.memory.total))),
        fact(say("box.process"), bytes(f.memory.process)), fact(say("box.load"), f.load.map((each) => number(each, 2)).join("  ")), fact(say("box.up"), duration(f.up))],
      fact(say("box.clock"), status.clock.complaint || say("box.clock_good"), h("small", {}, moment(status.time)),
        status.clock.synchronised === false && h("small", {}, say("box.clock_alone")))),
      can("administrator") && h("p", { class: "buttons" }, h("button", { "data-act": "reload" }, say("person.reload")), h("button", { "data-act": "backup" }, say("person.backup")))),
    h("section", { class: "card" }, h("h2", {}, say("box.records")), (historian.failure || historian.complaint) && h("p", { class: "error" }, historian.failure || historian.complaint),
      h("dl", { class: "facts" }, fact(say("box.records"), lost ? say("box.lost", { count: lost }) : say("box.kept")),
        fact(say("box.historian"), f ? bytes(f.records.historian) : "–", h("small", {}, historian.path)), f && fact(say("box.audit"), bytes(f.records.audit)))),
    h("section", { class: "card" }, h("h2", {}, say("box.parts")),
      grid([say("word.name"), say("box.running"), say("box.restarts"), say("box.failure")], parts.map(([part, how]) => [part, how.running || how.failure ? shown(how.running) : say("box.between"), how.restarts, how.failure]))));
}
