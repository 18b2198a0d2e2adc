// Who is logged in, and what a person may change.
import { ask, bytes, h, make, moment, parse, person, say, setPerson, start } from "./dom.js";
import { state } from "./live.js";

export const personBox = () => h("div", { id: "person" }, person.name
  ? [h("span", { class: "who" }, h("b", {}, person.name), h("small", {}, say(`role.${person.role}`))),
    h("button", { "data-act": "logout" }, say("person.logout"))]
  : h("button", { "data-act": "login" }, say("person.login")));

const box = document.getElementById("dialog");

// A dialog with fields; `work` gets their values, and its error is said in the dialog.
function dialog(title, fields, confirm, work, more = []) {
  const said = make(h("p", { class: "error", role: "alert" }));
  const inputs = fields.map(([name, label, attributes]) => h("label", {}, h("span", {}, label), h("input", { name, required: true, ...attributes })));
  const form = make(h("form", { method: "dialog" }, h("h2", { id: "dialog-title" }, title), more, inputs, said,
    h("div", { class: "buttons" }, h("button", { type: "button", value: "cancel" }, say("person.cancel")), h("button", { type: "submit", class: "main" }, confirm))));
  form.querySelector("[value=cancel]").onclick = () => box.close();
  form.onsubmit = async (event) => {
    event.preventDefault();
    said.textContent = "";
    try {
      await work(Object.fromEntries(new FormData(form)));
      box.close();
    } catch (error) {
      said.textContent = error.message;
    }
  };
  box.replaceChildren(form);
  box.showModal();
}

const line = { autocomplete: "off", maxlength: 200 };

export const acts = {
  login(_, changed) {
    dialog(say("person.login"), [["name", say("person.name"), { autocomplete: "username", maxlength: 60, autofocus: true }], ["password", say("person.password"), { type: "password", autocomplete: "current-password", maxlength: 200 }]],
      say("person.login"), async (given) => {
        setPerson(await ask("POST", "/api/session", given));
        if (!start.may_read) location.reload();
        changed();
      }, [h("p", { class: "quiet" }, say("person.whom"), " ", h("code", {}, "decanter user add NAME --role operator"))]);
  },
  async logout(_, changed) {
    await ask("DELETE", "/api/session").catch(() => {});
    setPerson({ name: null, role: null, token: null });
    if (!start.open) location.reload();
    changed();
  },
  alarm(button, changed) {
    const { machine, of: alarm, change } = button.dataset;
    const minutes = change === "shelve" ? [["minutes", say("person.minutes"), { type: "number", min: 1, value: 60 }]] : [];
    const row = state.machines[machine]?.alarms.find((each) => each.name === alarm);
    dialog(`${button.textContent}: ${row ? `${row.of}: ${row.title}` : alarm}`, [["reason", say("person.reason"), line], ...minutes], button.textContent, async (given) => {
      const more = given.minutes ? { minutes: Number(given.minutes) } : {};
      await ask("POST", "/api/alarm", { machine, alarm, change, reason: given.reason, ...more }).catch((error) => expired(error, changed));
    });
  },
  // One after the other: what somebody else acknowledged meanwhile is no obstacle to the rest.
  async acknowledge(button, changed) {
    let refused = null;
    button.disabled = true;
    for (const [machine, alarm] of parse(button.dataset.shown)) {
      try {
        await ask("POST", "/api/alarm", { machine, alarm, change: "acknowledge" });
      } catch (error) {
        refused = error;
        if (error.status === 401) break;
      }
    }
    button.disabled = false;
    if (refused) await failed(refused, changed);
  },
  arm(button, changed) {
    const { machine } = button.dataset;
    dialog(`${say("person.arm")}: ${state.machines[machine]?.label ?? machine}`, [["reason", say("person.reason"), line], ["minutes", say("person.minutes"), { type: "number", min: 1, max: 480, value: 60 }]], say("person.arm"), async ({ reason, minutes }) => {
      await ask("POST", "/api/arm", { machine, reason, minutes: Number(minutes) }).catch((error) => expired(error, changed));
    }, aboutArming(state.machines[machine]?.arming));
  },
  disarm(button, changed) {
    dialog(`${say("person.disarm")}: ${state.machines[button.dataset.machine]?.label ?? button.dataset.machine}`, [["reason", say("person.reason"), line]], say("person.disarm"), async ({ reason }) => {
      await ask("POST", "/api/disarm", { machine: button.dataset.machine, reason }).catch((error) => expired(error, changed));
    });
  },
  promote(button, changed) {
    const { machine, of: temperature, version, runs } = button.dataset;
    dialog(`${button.textContent}: ${version}`, [["reason", say("person.reason"), line]], button.textContent, async ({ reason }) => {
      await ask("POST", "/api/promote", { machine, temperature, version, reason }).catch((error) => expired(error, changed));
    }, [h("p", {}, say("model.consequence", { version, runs })), h("p", { class: "quiet" }, say("model.proven"))]);
  },
  // About the moment that the button names, or about now.
  note(button, changed) {
    const machines = state.order.map((name) => [name, state.machines[name].label]), at = button.dataset.at ? Number(button.dataset.at) : null;
    const choice = make(h("select", { name: "machine" }, machines.map(([name, label]) => h("option", { value: name, selected: name === button.dataset.machine }, label))));
    dialog(say("note.write"), [["text", say("note.note"), line]], say("note.keep"), async ({ text, machine }) => {
      await ask("POST", "/api/notes", { machine, text, ...(at === null ? {} : { at }) }).catch((error) => expired(error, changed));
      dispatchEvent(new Event("noted"));
      changed();
    }, [at !== null && h("p", {}, moment(at)), h("label", {}, h("span", {}, say("word.machine")), choice)]);
  },
  onshift(_, changed) {
    dialog(say("shift.set"), [["names", say("shift.names"), line]], say("note.keep"), async ({ names }) => {
      await ask("POST", "/api/shift", { names }).catch((error) => expired(error, changed));
      dispatchEvent(new Event("noted"));
      changed();
    }, [h("p", { class: "quiet" }, say("shift.how"))]);
  },
  mail(button, changed) {
    dialog(say("shift.mail"), [], say("person.confirm"), async () => {
      const { told, missed } = await ask("POST", "/api/shift/mail", { hours: Number(button.dataset.hours) }).catch((error) => expired(error, changed));
      setTimeout(() => dialog(say("shift.mail"), [], say("person.confirm"), () => {}, 
        [h("p", {}, say("shift.mailed", { names: told.join(", ") })), ...Object.entries(missed).map(([name, reason]) => h("p", { class: "error" }, say("shift.not_mailed", { name, reason })))]));
    }, [h("p", { class: "quiet" }, say("shift.mail_to"))]);
  },
  backup(_, changed) {
    dialog(say("person.backup"), [], say("person.confirm"), async () => {
      const made = await ask("POST", "/api/backup", {}).catch((error) => expired(error, changed));
      // After the dialog that asked for it has closed.
      setTimeout(() => dialog(say("person.backup_made"), [], say("person.confirm"), () => {},
        [h("p", {}, h("code", {}, made.folder)), h("p", {}, say("person.backup_size", { files: made.files, size: bytes(made.bytes) })), ...(made.damaged ? [h("p", { class: "error" }, made.damaged)] : []), h("p", { class: "quiet" }, say("person.restore"), " ", h("code", {}, `decanter keep restore ${made.folder} --overwrite${made.signed ? "" : ` --seal ${made.seal}`}`))]));
    }, [h("p", { class: "quiet" }, say("person.backup_what"))]);
  },
  async reload(_, changed) {
    try {
      const { changes } = await ask("POST", "/api/reload", { dry_run: true });
      const rows = Object.entries(changes).flatMap(([name, sentences]) => sentences.map((each) => h("li", {}, `${name}: ${each}`)));
      dialog(say("person.reload"), [], say("person.confirm"), () => ask("POST", "/api/reload", { dry_run: false }),
        [h("h3", {}, say("person.changes")), rows.length ? h("ul", {}, rows) : h("p", {}, say("person.no_changes"))]);
    } catch (error) {
      await failed(error, changed);
    }
  },
};

// Where something would be written, and what, as it was when the dialog was opened.
function aboutArming(about) {
  if (!about) return [];
  const fact = (label, ...what) => h("div", { class: "fact" }, h("dt", {}, label), h("dd", {}, what));
  return [h("dl", { class: "arming", tabindex: "0" }, fact(say("arming.address"), about.address), fact(say("arming.identity"), about.identity),
    about.blocks.map((block) => [
      fact(say("arming.block", { label: block.label }), say("arming.block_at", { words: block.words, address: block.address })),
      fact(say("arming.refusals"), block.refusals),
      fact(say("arming.numbers"), block.numbers.length ? block.numbers.map(([name, text]) => h("div", {}, `${name}: ${text}`)) : say("arming.no_block"))]))];
}

// A session that has ended is logged in anew; anything else is said.
function expired(error, changed) {
  if (error.status === 401) {
    setPerson({ name: null, role: null, token: null });
    changed();
  }
  throw error;
}
async function failed(error, changed) {
  if (error.status === 401) {
    setPerson({ name: null, role: null, token: null });
    changed();
    acts.login(null, changed);
  } else dialog(say("word.attention"), [], say("person.confirm"), () => {}, [h("p", {}, error.message)]);
}
