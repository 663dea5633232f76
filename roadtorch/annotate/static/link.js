// The way to the server: requests with the token, and acts that are kept until it has them.

const TOKEN = new URLSearchParams(location.search).get("token") ?? "";
const WINDOW = (sessionStorage.roadtorchWindow ??= crypto.randomUUID());

export class Refusal extends Error {
  constructor(status, message) {
    super(message);
    this.status = status;
  }
}

export function address(path, values = {}) {
  return `/api/${path}?${new URLSearchParams({ ...values, token: TOKEN })}`;
}

// The answer to a request. Refusal where the server says no; TypeError where there is none.
export async function ask(path, values = {}, body = undefined) {
  const query = new URLSearchParams(values);
  const options = { headers: { "x-token": TOKEN }, signal: AbortSignal.timeout(60000) };
  if (body !== undefined) Object.assign(options, { method: "POST", body: JSON.stringify(body) });
  const answer = await fetch(`/api/${path}?${query}`, options);
  if (!answer.ok) {
    const told = await answer.json().catch(() => ({ error: `the server says ${answer.status}` }));
    throw new Refusal(answer.status, told.error);
  }
  return answer;
}

// Acts of this window that the server has not yet. They are in the browser's store until it has:
// a reload, a crash or a server that is started again loses none. Sent twice, they count once.
export class Outbox {
  constructor(told) {
    this.told = told; // told(act entry, state or null, problem or null)
    this.key = `roadtorch-outbox:${WINDOW}`;
    this.waiting = this.adopted();
    this.keep();
    this.busy = false;
  }

  // What other windows left behind is sent from here; one that is open keeps its own in mind.
  adopted() {
    const found = new Map();
    for (const key of Object.keys(localStorage).filter((k) => k.startsWith("roadtorch-outbox:"))) {
      for (const entry of JSON.parse(localStorage[key])) found.set(entry.act.id, entry);
      if (key !== this.key) delete localStorage[key];
    }
    return [...found.values()];
  }

  keep() {
    if (this.waiting.length) localStorage[this.key] = JSON.stringify(this.waiting);
    else delete localStorage[this.key];
  }

  add(name, act) {
    this.waiting.push({ name, act: { id: crypto.randomUUID(), ...act } });
    this.keep();
    return this.send();
  }

  // Send all in order. Stops where the server does not answer; what it refuses is dropped.
  async send() {
    if (this.busy) return;
    this.busy = true;
    try {
      while (this.waiting.length) {
        const entry = this.waiting[0];
        const { name, act } = entry;
        let state = null;
        let problem = null;
        try {
          state = await (await ask("event", { name }, act)).json();
        } catch (error) {
          if (!(error instanceof Refusal) || error.status >= 500 || error.status === 403) throw error;
          problem = error;
        }
        this.waiting.shift();
        this.keep();
        this.told(entry, state, problem);
      }
    } finally {
      this.busy = false;
    }
  }
}
