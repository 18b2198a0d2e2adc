// The frame of the page: which view is shown, the banner when the stream is cut, who is logged in.
import { ask, duration, h, make, morph, say, setPerson, start } from "./dom.js";
import { age, follow, isCut, state } from "./live.js";
import { acts, personBox } from "./person.js";
import { alarmsView, scorecardView, waits } from "./records.js";
import { boxView, communicationView, modelView } from "./inside.js";
import { machineView, modeBadge, plantView, wallView } from "./plant.js";
import { shiftView } from "./shift.js";
import { soundAlarms, sounds, switchSound } from "./sound.js";
import { trendsView } from "./trends.js";

const VIEWS = {
  plant: plantView,
  wall: wallView,
  alarms: alarmsView,
  shift: shiftView,
  trends: trendsView,
  scorecard: scorecardView,
  model: modelView,
  communication: communicationView,
  box: boxView,
};
const view = document.getElementById("view");
let place = "", rendered = null;

// A link is anybody's text: what is no view of ours is the plant, and what is no encoding stands for itself.
function decoded(part) {
  try {
    return decodeURIComponent(part);
  } catch {
    return part;
  }
}

function here() {
  const [name, ...rest] = location.hash.replace(/^#\/?/, "").split("/").map(decoded);
  return { name: Object.hasOwn(VIEWS, name) || name === "machine" ? name : "plant", rest };
}

function render() {
  const { name, rest } = here();
  const cut = start.may_read && isCut();
  document.body.classList.toggle("cut", cut);
  showCut(cut);
  showNav(name);
  showMode(cut);
  morph(document.getElementById("person"), personBox());
  const fresh = h("main", { id: "view", tabindex: "-1" }, content(name, rest, cut));
  if (place !== location.hash) {
    view.replaceChildren(...fresh.children.map(make));
    if (place !== "") view.focus({ preventScroll: true }), scrollTo(0, 0);
    place = location.hash;
  } else morph(view, fresh);
  rendered?.();
}

// A view gives its elements, or [elements, what is drawn once they are there].
function content(name, rest, cut) {
  rendered = null;
  if (!start.may_read) return h("p", { class: "lead" }, say("person.needed"));
  if (!state.order.length) {
    if (state.arrived === null || cut) return h("p", { class: "lead" }, cut ? say("live.never") : say("word.loading"));
    return h("section", { class: "card" }, h("h2", {}, say("live.empty")), h("p", {}, say("live.begin")), h("p", {}, h("code", {}, "decanter machine add")));
  }
  const made = name === "machine" ? machineView(rest[0], cut) : VIEWS[name](rest, cut);
  if (!Array.isArray(made)) return made;
  rendered = made[1];
  return made[0];
}

function showCut(cut) {
  const banner = document.getElementById("cut");
  banner.hidden = !cut;
  if (!cut) return;
  const seconds = age();
  const said = seconds === null ? say("live.never") : say("live.age", { age: duration(seconds) });
  morph(banner, h("div", { id: "cut", role: "alert" }, h("strong", {}, say("live.cut")), h("span", {}, said)));
}

// Whether anything is written to a PLC, on every view: of several machines how many.
function showMode(cut) {
  const modes = state.order.map((name) => state.machines[name].mode);
  const most = ["armed", "shadow", "off"].find((mode) => modes.includes(mode));
  const of = modes.length > 1 && most ? ` ${modes.filter((mode) => mode === most).length}/${modes.length}` : "";
  morph(document.getElementById("mode"), h("div", { id: "mode" }, most && modeBadge(most, cut, of)));
}

function showNav(name) {
  // Of one cause all is one.
  const waiting = new Set(state.order.flatMap((each) =>
    state.machines[each].alarms.filter(waits).map((alarm) => `${each} ${alarm.under || alarm.name}`))).size;
  const links = Object.keys(VIEWS).map((each) =>
    h("a", { href: `#/${each}`, "aria-current": each === name ? "page" : null },
      say(`nav.${each}`), each === "alarms" && sounds() && h("span", { title: say("alarm.sound") }, "♪"), each === "alarms" && waiting > 0 && h("span", { class: "count" }, String(waiting))));
  morph(document.getElementById("nav"), h("nav", { id: "nav", "aria-label": say("nav.main") }, links));
}

document.addEventListener("click", (event) => {
  const target = event.target.closest("[data-act]");
  if (target?.dataset.act === "sound") switchSound(), render();
  else if (target) acts[target.dataset.act]?.(target, render);
});
document.addEventListener("change", (event) => {
  if (event.target.id === "language") location.search = `?lang=${event.target.value}`;
});
addEventListener("hashchange", render);

ask("GET", "/api/session")
  .then((found) => setPerson(found))
  .catch(() => {})
  .finally(render);
let waiting = false;
follow(() => {
  soundAlarms(); // a page that nobody looks at is heard all the same
  // Many pictures between two frames are drawn once; a hidden page is drawn when it is looked at.
  if (waiting || document.hidden) return;
  waiting = true;
  requestAnimationFrame(() => {
    waiting = false;
    render();
  });
});
document.addEventListener("visibilitychange", render);
render();
