/** The server, asked with the token of this tab. */

/** How long the server may be silent before the page says so: it writes a line each half second. */
const SILENT_MS = 1500;
const AGAIN_MS = 400;

/** What the server refused, or that it did not answer (`status` 0). */
export class ApiError extends Error {
  /**
   * Keep what the server said.
   * @param {number} status HTTP status; 0 where the server did not answer
   * @param {string} message in words
   * @param {any} [body] the answer, where it could be read
   */
  constructor(status, message, body = null) {
    super(message);
    this.status = status;
    this.body = body;
  }

  /**
   * Whether this window shows another run than the one that is served now.
   * @returns {boolean}
   */
  get ofOtherRun() {
    return this.status === 409 && Boolean(this.body?.served);
  }
}

/**
 * Take the token out of the address, where it came in the fragment, and keep it for this tab.
 * @returns {string|null} null where this tab never had one
 */
export function takeToken() {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given !== null) {
    sessionStorage.setItem("planish-token", given);
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem("planish-token");
}

export class Api {
  /**
   * Ask with a token.
   * @param {string} token that of this tab
   */
  constructor(token) {
    this.token = token;
    /** Run that this window shows: a change of another one is refused. */
    this.run = "";
  }

  /**
   * Ask the server; an answer that is no success is thrown as ApiError.
   * @param {string} path below `/api/`
   * @param {RequestInit} [init] as of the browser's `fetch`
   * @returns {Promise<Response>}
   */
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

  /**
   * Ask for JSON.
   * @param {string} path below `/api/`
   * @param {RequestInit} [init] as of the browser's `fetch`
   * @returns {Promise<any>}
   */
  async get(path, init) {
    return (await this.fetch(path, init)).json();
  }

  /**
   * Send JSON, and get JSON back.
   * @param {string} path below `/api/`
   * @param {object} [body] what is sent
   * @returns {Promise<any>}
   */
  post(path, body = {}) {
    const headers = { "Content-Type": "application/json", "Planish-Run": encodeURIComponent(this.run) };
    return this.get(path, { method: "POST", headers, body: JSON.stringify(body) });
  }

  /**
   * Follow the server's news for as long as the page is open, through lost connections.
   * @param {object} listener what is called
   * @param {(line: any) => void} listener.onNews gets each line of news
   * @param {(status: number) => void} listener.onLost gets the status with which the server refuses this page, 0 where
   *   it does not answer
   * @param {() => Promise<void>} listener.onFound called when the server answers again
   * @returns {Promise<never>}
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

  /**
   * Read a streamed answer line by line until it ends or falls silent.
   * @param {string} path below `/api/`
   * @param {(line: any) => void} onLine gets each line, read as JSON
   * @param {() => Promise<void>} onOpen called before the first line
   * @returns {Promise<void>}
   */
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
