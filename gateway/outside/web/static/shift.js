// The report of a shift: what was told and what came of it, what was hottest, who did what. It is made to be printed.
import { ask, byWhom, clock, duration, fact, grid, h, moment, number, say, withUnit } from "./dom.js";
import { isCut, state } from "./live.js";
import { can, pastTitle } from "./records.js";
import { stateKey } from "./plant.js";

const HOURS = [8, 12, 24], AGAIN_MS = 60_000;
const look = { hours: HOURS[0], asked: "", at: 0, report: null, error: "" };

export function shiftView() {
  const key = `${look.hours}`;
  if (!isCut() && (look.asked !== key || performance.now() - look.at > AGAIN_MS)) {
    if (look.asked !== key) look.report = null;
    Object.assign(look, { asked: key, at: performance.now() });
    ask("GET", "/api/shift", { hours: look.hours }).then((report) => look.asked === key && Object.assign(look, { report, error: "" }), (error) => (look.error = error.message));
  }
  return h("section", { class: "view shift" },
    h("div", { class: "controls" },
      h("div", { class: "spans", role: "group", "aria-label": say("trend.span") }, HOURS.map((hours) => h("button", { "data-act": "hours", "data-hours": hours, "aria-pressed": String(look.hours === hours) }, `${hours} h`))),
      h("button", { "data-act": "print" }, say("shift.print")),
      can("operator") && [h("button", { "data-act": "mail", "data-hours": look.hours }, say("shift.mail")), h("button", { "data-act": "onshift" }, say("shift.set")), h("button", { "data-act": "note", "data-machine": state.order[0] }, say("note.write"))]),
    look.error ? h("p", { class: "error" }, look.error) : !look.report ? h("p", { class: "quiet" }, say("word.loading")) : reportOf(look.report));
}

addEventListener("click", (event) => {
  const button = event.target.closest("[data-act=hours], [data-act=print]");
  if (!button) return;
  if (button.dataset.act === "print") print();
  else {
    look.hours = Number(button.dataset.hours);
    dispatchEvent(new HashChangeEvent("hashchange"));
  }
});
// What has just been written is in the report at once.
addEventListener("noted", () => (look.at = -Infinity));

function reportOf({ start, end, machines, on_shift: there, notes, deeds, left_out: before }) {
  const label = (name) => state.machines[name]?.label ?? name ?? "";
  return [
    h("h2", {}, say("shift.title", { from: moment(start), to: moment(end) })),
    h("p", {}, there ? say("shift.there", { names: there.names, by: byWhom(there.by), since: moment(there.time) }) : say("shift.nobody")),
    Object.entries(machines).map(([name, machine]) => h("section", { class: "card", "data-key": name }, h("h3", {}, label(name)), machineOf(name, machine))),
    h("section", { class: "card" }, h("h3", {}, say("note.notes")), leftOut(before.notes), notes.length
      ? grid([say("word.time"), say("word.machine"), say("note.note"), say("shift.who")], notes.map((note) => [moment(note.time), label(note.machine), note.text, byWhom(note.by)]))
      : h("p", { class: "quiet" }, say("word.none"))),
    h("section", { class: "card" }, h("h3", {}, say("shift.deeds")), leftOut(before.deeds), deeds.length
      ? grid([say("word.time"), say("shift.what"), say("shift.about"), say("shift.who"), say("word.reason")], deeds.map((deed) => [moment(deed.time), say(`deed.${stateKey(deed.kind.replace(":", ""))}`), aboutDeed(deed, label), byWhom(deed.by), deed.reason]))
      : h("p", { class: "quiet" }, say("word.none"))),
  ];
}

// Of what a deed was: the machine, and the alarm in the plant's words or the version of a model.
const aboutDeed = ({ machine, alarm, version }, label) => [machine && label(machine),
  alarm && pastTitle({ ...alarm, condition: alarm.alarm }, state.machines[machine]?.labels ?? {}), version].filter(Boolean).join(", ");

function machineOf(name, { alarms, temperatures, states, unwatched, writes }) {
  const shown = state.machines[name], labels = shown?.labels ?? {};
  const about = (tag) => shown?.temperatures.find((row) => row.tag === tag);
  const at = (time) => ` (${clock(time)})`;
  const blocks = Object.entries(writes);
  return [
    h("dl", { class: "facts" }, temperatures.flatMap(({ tag, limit, hottest, nearest }) => {
      const unit = about(tag)?.unit ?? "", label = about(tag)?.label ?? tag;
      return [fact(`${label}: ${say("shift.hottest")}`, hottest ? [h("b", {}, withUnit(number(hottest.value), unit)), at(hottest.time)] : "–", h("small", {}, `${say("word.limit")} ${withUnit(number(limit), unit)}`)),
        fact(`${label}: ${say("shift.nearest")}`, nearest.minutes === null ? (nearest.forecasts ? `> ${withUnit(number(nearest.horizon / 60, 0), "min")}` : "–") : [h("b", {}, withUnit(nearest.minutes < 1 ? "< 1" : number(nearest.minutes, nearest.minutes < 10 ? 1 : 0), "min")), at(nearest.time)],
          h("small", {}, nearest.forecasts ? say("shift.median") : say("shift.no_forecasts")))];
    }),
      fact(say("shift.unwatched"), unwatched.count ? `${duration(unwatched.seconds)} (${unwatched.count} ×)` : say("word.none")),
      fact(say("score.blocks"), blocks.length ? blocks.map(([verdict, count]) => h("div", {}, `${say(`verdict.${stateKey(verdict)}`)}: ${count}`)) : say("word.none"))),
    h("h4", {}, say("nav.alarms")),
    alarms.length ? grid([say("word.time"), say("alarm.alarm"), say("alarm.priority"), say("shift.came"), say("alarm.acknowledged_by")], alarms.map((one) => [moment(one.raised), pastTitle({ ...one, condition: one.alarm }, labels, one.ended === null ? "kind" : "past"), one.priority, came(one), one.acknowledged ? `${byWhom(one.by)}, ${duration(one.acknowledged - one.raised)}` : say("shift.by_nobody")]))
      : h("p", { class: "quiet" }, say("shift.no_alarms")),
    states.length > 0 && [h("h4", {}, say("shift.states")), grid([say("word.state"), say("shift.time"), say("shift.entries")], states.map((one) => [one.state, duration(one.seconds), one.entries]))],
  ];
}

const leftOut = (count) => count > 0 && h("p", {}, say("shift.left_out", { count }));

// What came of an alarm; of a warning, whether the limit was passed while it stood.
function came(one) {
  const ended = one.ended === null ? say("shift.stands") : say("shift.over_after", { age: duration(one.ended - one.raised) });
  if (!one.warning) return ended;
  return `${one.limit_after === null ? say(one.ended === null ? "shift.not_passed_yet" : "shift.not_passed") : say("shift.passed", { age: duration(one.limit_after) })}; ${ended}`;
}
