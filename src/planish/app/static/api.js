/** The server, asked with the token of this tab. */

/** How long the server may be silent before the page says so: it writes a line each half second. */
const SILENT_MS = 1500;
const AGAIN_MS = 400;

/** What the server refused, or that it did not answer (`status` 0). */
export class ApiError extends Error {
  constructor(status, message, body = null) {
    super(message);
    this.status = status;
    this.body = body;
  }

  /** Whether this window shows another run than the one that is served now. */
  get ofOtherRun() {
    return this.status === 409 && Boolean(this.body?.served);
  }
}

/** Take the token out of the address, where it came in the fragment, and keep it for this tab. */
export function takeToken() {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given !== null) {
    sessionStorage.setItem("planish-token", given);
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem("planish-token");
}

export class Api {
  constructor(token) {
    this.token = token;
    /** Run that this window shows: a change of another one is refused. */
    this.run = "";
  }

  /** `path`: below `/api/` */
  async fetch(path, init = {}) {
    const headers = { Authorization: `Bearer ${this.token}`, ...init.headers };
    let response;
    try {
      response = await fetch(`/api/${path}`, { cache: "no-store", ...init, headers });
    } catch (error) {
      if (init.signal?.aborted) throw error;
      throw new ApiError(0, "No connection to planish.");
    }
    if (response.ok) return response;
    const body = await response.json().catch(() => null);
    throw new ApiError(response.status, body?.error ?? body?.message ?? `The server answers ${response.status}.`, body);
  }

  async get(path, init) {
    return (await this.fetch(path, init)).json();
  }

  post(path, body = {}) {
    const headers = { "Content-Type": "application/json", "Planish-Run": encodeURIComponent(this.run) };
    return this.get(path, { method: "POST", headers, body: JSON.stringify(body) });
  }

  /**
   * Follow the server's news for as long as the page is open, through lost connections.
   * `listener`: `onLost` is told the status with which the server refuses this page, 0 where it does not answer
   */
  async follow({ onNews, onLost, onFound }) {
    for (let first = true; ; first = false) {
      let status = 0;
      try {
        await this.readLines("events", onNews, first ? async () => {} : onFound);
      } catch (error) {
        status = error.status ?? 0; // whatever ended it, the connection is gone until the next attempt succeeds
      }
      onLost(status);
      await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
    }
  }

  /** Read a streamed answer line by line until it ends or falls silent. */
  async readLines(path, onLine, onOpen) {
    const stop = new AbortController();
    let alarm = setTimeout(() => stop.abort(), SILENT_MS);
    try {
      const response = await this.fetch(path, { signal: stop.signal });
      await onOpen();
      const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
      for (let rest = ""; ; ) {
        const { done, value } = await reader.read();
        if (done) return;
        clearTimeout(alarm);
        alarm = setTimeout(() => stop.abort(), SILENT_MS);
        const lines = (rest + value).split("\n");
        rest = lines.pop() ?? "";
        for (const line of lines) if (line.trim()) onLine(JSON.parse(line));
      }
    } finally {
      clearTimeout(alarm);
      stop.abort();
    }
  }
}
