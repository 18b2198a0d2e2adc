// Any tags over any time: what was measured, gaps as gaps, and beside it what had been said before.
import { ask, duration, h, moment, number, say, unit } from "./dom.js";
import { state } from "./live.js";
import { chart, COLOURS, FAN, faint, INK, measuredSeries } from "./draw.js";
import { can } from "./records.js";

const SPANS = [["90 d", 7776000], ["7 d", 604800], ["1 d", 86400], ["6 h", 21600], ["1 h", 3600], ["10 min", 600], ["1 min", 60]];
// What went before is laid over what is shown: so many seconds before it.
const EARLIER = [["1 h", 3600], ["1 d", 86400], ["7 d", 604800]];
const now = (machine) => state.machines[machine].status.time;

// What is looked at: `past` are the stretches that were zoomed out of, `at` the moment that was pointed at.
const look = { machine: null, tags: [], span: 3600, range: null, past: [], horizon: "", earlier: "", at: null, asked: "", data: null, error: "" };

export function trendsView([wanted]) {
  const machine = look.machine && state.machines[look.machine] ? look.machine : (look.machine = wanted && state.machines[wanted] ? wanted : state.order[0]);
  const { status, labels } = state.machines[machine];
  const names = Object.keys(status.values).filter((name) => typeof status.values[name].value !== "string");
  look.tags = look.tags.filter((tag) => names.includes(tag));
  if (!look.tags.length) look.tags = [status.temperature];
  const horizons = status.forecast?.horizons ?? [];
  const parts = h("section", { class: "view trends" },
    h("div", { class: "controls" },
      h("label", {}, h("span", {}, say("word.machine")), h("select", { id: "trend-machine" }, state.order.map((name) => h("option", { value: name, selected: name === machine }, state.machines[name].label)))),
      h("div", { class: "spans", role: "group", "aria-label": say("trend.span") }, SPANS.map(([label, seconds]) => h("button", { "data-act": "span", "data-span": seconds, "aria-pressed": String(!look.range && look.span === seconds) }, label)),
        h("button", { "data-act": "back", disabled: !look.past.length }, say("trend.back"))),
      h("label", {}, h("span", {}, say("trend.compare")), h("select", { id: "trend-earlier" }, h("option", { value: "" }, "–"),
        EARLIER.map(([label, seconds]) => h("option", { value: seconds, selected: String(seconds) === look.earlier }, say("trend.earlier", { age: label }))))),
      horizons.length > 0 && h("label", {}, h("span", {}, say("trend.forecasts")), h("select", { id: "trend-horizon" }, h("option", { value: "" }, "–"),
        horizons.map((each) => h("option", { value: each, selected: String(each) === look.horizon }, say("trend.said_before", { minutes: number(each / 60, 0) })))))),
    h("details", { class: "tags", open: innerWidth > 700 }, h("summary", {}, say("trend.signals")), names.map((name) =>
      h("label", {}, h("input", { type: "checkbox", value: name, "data-tag": name, checked: look.tags.includes(name) }),
        h("span", {}, labels[name] ?? name, status.values[name].unit && ` (${unit(status.values[name].unit)})`, labels[name] && h("small", {}, name))))),
    h("p", { class: look.error ? "error" : "quiet" }, look.error || `${say("trend.hint")} ${look.data ? say("trend.resolution", { width: look.data.width ? duration(look.data.width) : say("trend.readings") }) : ""}`),
    h("div", { class: "chart", id: "trend", "data-keep": "", "data-key": "trend" }),
    notesOf(machine));
  return [parts, () => fetchOnce(machine, status)];
}

// What people have noted of the stretch that is shown, each with the number that it has on the time axis.
function notesOf(machine) {
  const notes = look.data?.notes ?? [];
  return h("section", { class: "notes" },
    can("operator") && h("p", { class: "buttons" }, h("button", { "data-act": "note", "data-machine": machine, "data-at": look.at }, look.at === null ? say("note.write") : say("note.about", { time: moment(look.at) }))),
    look.data?.leftOut > 0 && h("p", { class: "quiet" }, say("shift.left_out", { count: look.data.leftOut })),
    notes.length > 0 && h("ol", {}, notes.map((note, place) => h("li", {}, h("b", {}, `${place + 1}`), " ", h("time", {}, moment(note.time)), ` ${note.text} `, h("small", {}, note.by)))));
}
addEventListener("noted", () => (look.asked = ""));

addEventListener("change", (event) => {
  const { target } = event;
  if (target.id === "trend-machine") Object.assign(look, { machine: target.value, tags: [], past: [], range: null });
  else if (target.id === "trend-horizon") look.horizon = target.value;
  else if (target.id === "trend-earlier") look.earlier = target.value;
  else if (target.dataset?.tag) look.tags = target.checked ? [...new Set([...look.tags, target.value])].slice(-8) : look.tags.filter((tag) => tag !== target.value);
  else return;
  dispatchEvent(new HashChangeEvent("hashchange"));
});
addEventListener("click", (event) => {
  const button = event.target.closest("[data-act=span], [data-act=back]");
  if (!button) return;
  if (button.dataset.act === "back") look.range = look.past.pop() ?? null;
  else Object.assign(look, { span: Number(button.dataset.span), range: null, past: [] });
  dispatchEvent(new HashChangeEvent("hashchange"));
});

// Ask for what is looked at; what goes on until now is asked again as time passes, by a hundredth of the span.
function fetchOnce(machine, status) {
  const step = Math.max(look.span / 100, 2);
  const end = look.range ? look.range[1] : Math.ceil(now(machine) / step) * step;
  const start = look.range ? look.range[0] : end - look.span;
  const key = JSON.stringify([machine, look.tags, start, end, look.horizon, look.earlier]);
  const place = document.getElementById("trend");
  if (!place || !window.uPlot) return;
  if (look.asked === key) {
    if (!place.firstChild && look.data) draw(place);
    return;
  }
  look.asked = key;
  const followed = [status.temperature, ...status.further.map((one) => one.temperature)];
  const shift = Number(look.earlier), shown = look.tags.length;
  const asks = look.tags.map((tag) => ask("GET", "/api/trend", { machine, tag, start, end }));
  if (shift) asks.push(...look.tags.map((tag) => ask("GET", "/api/trend", { machine, tag, start: start - shift, end: end - shift })));
  const said = look.horizon && look.tags.find((tag) => followed.includes(tag));
  if (said) asks.push(ask("GET", "/api/forecasts", { machine, temperature: said, horizon: look.horizon, start, end }));
  Promise.all(asks).then((all) => {
    if (look.asked !== key) return;
    look.error = "";
    const { labels } = state.machines[machine];
    look.data = { width: all[0].width, start, end, notes: [], tags: look.tags.map((tag) => (labels[tag] ? `${labels[tag]} (${tag})` : tag)), trends: all.slice(0, shown), shift, earlier: shift ? all.slice(shown, 2 * shown) : [], said: said ? all.at(-1) : null };
    draw(document.getElementById("trend") ?? place);
    // After what nobody waits longer for because of them.
    ask("GET", "/api/notes", { machine, start, end }).then(({ notes, left_out: leftOut }) => {
      if (look.asked !== key || !notes.length) return;
      Object.assign(look.data, { notes, leftOut });
      draw(document.getElementById("trend") ?? place);
    }, () => {});
  }, (error) => (look.error = error.message));
}

function draw(place) {
  const { trends, tags, said, start, end, notes, shift, earlier } = look.data;
  const tables = [], series = [], bands = [];
  trends.forEach((seen, place) => {
    const colour = COLOURS[place % COLOURS.length];
    if (seen.width) {
      tables.push([seen.times, seen.low, seen.high, seen.mean]);
      series.push({ ...faint(`${tags[place]} min`, colour), width: 0 }, { ...faint(`${tags[place]} max`, colour), width: 0 });
      bands.push({ series: [series.length, series.length - 1], fill: `${colour}30` });
    } else tables.push([seen.times, seen.mean]);
    series.push(measuredSeries(tags[place], colour));
  });
  earlier.forEach((seen, place) => {
    tables.push([seen.times.map((time) => time + shift), seen.mean]);
    const label = EARLIER.find(([, seconds]) => seconds === shift)[0];
    series.push({ ...measuredSeries(`${tags[place]}, ${say("trend.earlier", { age: label })}`, COLOURS[place % COLOURS.length]), width: 1, dash: [3, 3] });
  });
  if (said) {
    const colour = FAN;
    tables.push([said.times, said.low, said.high, said.mean]);
    series.push(faint("5 %", colour), faint("95 %", colour));
    bands.push({ series: [series.length, series.length - 1], fill: `${FAN}33` });
    series.push({ ...measuredSeries(say("trend.said_before", { minutes: number(said.horizon / 60, 0) }), colour), dash: [6, 4] });
  }
  // A null that stands for a gap is kept as one; a time that only another column has is none (uPlot's modes 2 and 1).
  const data = uPlot.join(tables, tables.map((table) => table.map((_, column) => (column ? 2 : 0))));
  chart(place, {
    height: 360, series, bands, select: true,
    scales: { x: { time: true, range: () => [start, end] } },
    hooks: { draw: [(u) => drawNotes(u, notes)], ready: [pointOut], setSelect: [(u) => {
      if (u.select.width < 8) return;
      const from = u.posToVal(u.select.left, "x"), to = u.posToVal(u.select.left + u.select.width, "x");
      look.past.push(look.range ?? null);
      look.range = [from, to];
      u.setSelect({ width: 0, height: 0 }, false);
      dispatchEvent(new HashChangeEvent("hashchange"));
    }] },
  }, data);
}

// A click that is no drag points at a moment, of which a note may be written.
function pointOut(u) {
  let from = 0;
  u.over.addEventListener("mousedown", (event) => (from = event.clientX));
  u.over.addEventListener("click", (event) => {
    if (Math.abs(event.clientX - from) >= 8) return;
    look.at = u.posToVal(event.clientX - u.over.getBoundingClientRect().left, "x");
    dispatchEvent(new HashChangeEvent("hashchange"));
  });
}

// A line with its number for each note, in the order of the list below.
function drawNotes({ ctx, bbox, valToPos }, notes) {
  ctx.save();
  Object.assign(ctx, { strokeStyle: INK, fillStyle: INK, font: `${12 * devicePixelRatio}px system-ui`, textAlign: "left", textBaseline: "top" });
  notes.forEach((note, place) => {
    const x = Math.round(valToPos(note.time, "x", true));
    ctx.fillRect(x, bbox.top, devicePixelRatio, bbox.height);
    ctx.fillText(`${place + 1}`, x + 3 * devicePixelRatio, bbox.top + 2);
  });
  ctx.restore();
}
