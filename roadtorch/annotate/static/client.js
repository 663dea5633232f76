// Requests to the server, and a queue of events that it has not acknowledged.

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

// Send a request. Throws Refusal on an error response, TypeError where the server does not answer.
export async function request(path, values = {}, body = undefined) {
  const query = new URLSearchParams(values);
  const options = { headers: { "x-token": TOKEN }, signal: AbortSignal.timeout(60000) };
  if (body !== undefined) Object.assign(options, { method: "POST", body: JSON.stringify(body) });
  const answer = await fetch(`/api/${path}?${query}`, options);
  if (!answer.ok) {
    const message = await answer.json().catch(() => ({ error: `HTTP status ${answer.status}` }));
    throw new Refusal(answer.status, message.error);
  }
  return answer;
}

// Events of this window that the server has not acknowledged, kept in localStorage, so that a reload,
// a crash or a restart of the server loses none. An event that is sent twice counts once. Servers of
// several folders may follow on one port: an event is sent to that of its folder alone.
export class Outbox {
  constructor(acknowledged) {
    this.acknowledged = acknowledged; // acknowledged(entry, state or null, error or null)
    this.key = `roadtorch-outbox:${WINDOW}`;
    this.folder = ""; // the server's, once it is known
    this.entries = this.restore();
    this.store();
    this.busy = false;
  }

  get waiting() {
    return this.entries.filter((entry) => entry.folder === this.folder);
  }

  // Take over events that closed windows left; an open window keeps its own in memory as well.
  restore() {
    const entries = new Map();
    for (const key of Object.keys(localStorage).filter((k) => k.startsWith("roadtorch-outbox:"))) {
      for (const entry of JSON.parse(localStorage[key])) entries.set(entry.event.id, entry);
      if (key !== this.key) delete localStorage[key];
    }
    return [...entries.values()];
  }

  store() {
    if (this.entries.length) localStorage[this.key] = JSON.stringify(this.entries);
    else delete localStorage[this.key];
  }

  add(name, event) {
    this.entries.push({ folder: this.folder, name, event: { id: crypto.randomUUID(), ...event } });
    this.store();
    return this.send();
  }

  // Send all in order. Stop where the server does not answer; drop events that it rejects.
  async send() {
    if (this.busy) return;
    this.busy = true;
    try {
      while (this.waiting.length) {
        const entry = this.waiting[0];
        const { folder, name, event } = entry;
        let state = null;
        let rejection = null;
        try {
          state = await (await request("event", { folder, name }, event)).json();
        } catch (error) {
          if (!(error instanceof Refusal) || error.status >= 500 || error.status === 403) throw error;
          rejection = error;
        }
        this.entries.splice(this.entries.indexOf(entry), 1);
        this.store();
        this.acknowledged(entry, state, rejection);
      }
    } finally {
      this.busy = false;
    }
  }
}
