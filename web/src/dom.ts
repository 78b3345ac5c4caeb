/** Small helpers for the elements of the page. */

export function by<T extends HTMLElement>(id: string): T { return document.getElementById(id) as T; }

export function made<K extends keyof HTMLElementTagNameMap>(name: K, text = ""): HTMLElementTagNameMap[K] {
  const found = document.createElement(name);
  found.textContent = text;
  return found;
}

/** Set a property where it is another: one that is set anew, though the same, is laid out and drawn anew. */
export function put<T, K extends keyof T>(at: T, name: K, value: T[K]): void { if (at[name] !== value) at[name] = value; }

/** Say something in a place, where it says something else. */
export function tell(id: string, text: string): void { put(by(id), "textContent", text); }

/** A button that is enabled while the panel allows a command. */
export function button(text: string, what: string, press: () => void): HTMLButtonElement {
  const found = made("button", text);
  found.dataset.what = what;
  found.onclick = press;
  return found;
}

export function value(id: string): string { return by<HTMLInputElement>(id).value.trim(); }

/** Whether a text is being written, to which blanks belong. */
export function writing(): boolean {
  const at = document.activeElement;
  return at instanceof HTMLTextAreaElement || (at instanceof HTMLInputElement && !["button", "checkbox", "file", "range"].includes(at.type));
}

/** Whether a key that is pressed now belongs to the field or list that has the focus. */
export function typing(): boolean {
  const at = document.activeElement;
  return writing() || at instanceof HTMLSelectElement || (at instanceof HTMLInputElement && at.type === "range");
}

let refuse = () => {};

/** Ask something in the page: a window of the browser's own would take the keys that stop. */
export function asked(text: string, yes: string): Promise<boolean> {
  refuse(); // what was asked before and not answered
  return new Promise((answer) => {
    const say = (agreed: boolean) => { put(by("ask-row"), "hidden", true); refuse = () => {}; answer(agreed); };
    refuse = () => say(false);
    tell("ask-text", text);
    tell("ask-yes", yes);
    by("ask-yes").onclick = () => say(true);
    by("ask-no").onclick = () => say(false);
    put(by("ask-row"), "hidden", false);
  });
}
