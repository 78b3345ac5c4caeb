/** Connection to the panel: reconnects by itself, and never sends old messages. */

import type { FromPanel, State } from "./messages";

const PROTOCOL = 1;
const ALIVE_MS = 1000;
const AGAIN_MS = 500;
/** Fields that change in every state, even if nothing moves. */
const PASSING = /"(?:seq|age_s|left_s)":[^,}]*/g;
const REFUSED = 4401; // code with which the panel closes the connection

export class Link {
  lease = "";
  state: State | null = null;
  /** The latest state with a change in more than its number, its age and the time left of control. */
  changedState: State | null = null;
  /** Called at each stop that this page asks for. */
  stopped = (): void => {};
  /** Whether a state has come over the connection that is open now. */
  hears = false;
  /** Time of arrival of the latest state, by the page's clock, ms. */
  heardMs = 0;
  private lasting = ""; // the latest state, without the fields that change in every state
  private socket: WebSocket | null = null;
  private number = 0;
  private client = 0;
  private stops = 0;

  /** Why the panel refuses this page; empty if it does not. */
  refused = "";

  constructor(
    private readonly name: string,
    public token: string,
    private readonly heard: (message: FromPanel) => void,
    private readonly lost: () => void,
  ) {
    this.connect();
    setInterval(() => {
      if (this.lease) this.say({ type: "alive", lease: this.lease });
    }, ALIVE_MS);
  }

  private connect(): void {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/api/live`);
    this.socket = socket;
    socket.onopen = () => this.say({ type: "hello", protocol: PROTOCOL, name: this.name, token: this.token });
    socket.onmessage = (event) => {
      const text = String(event.data);
      const message = JSON.parse(text) as FromPanel;
      if (message.type === "state") {
        this.state = message;
        this.hears = true;
        this.heardMs = performance.now();
        const lasting = text.replace(PASSING, "");
        if (lasting !== this.lasting) [this.lasting, this.changedState] = [lasting, message];
      }
      if (message.type === "welcome") [this.number, this.client] = [0, message.client];
      if (message.type === "leased") this.lease = message.lease;
      this.heard(message);
    };
    socket.onclose = (event) => {
      this.lease = "";
      this.hears = false;
      this.refused = event.code === REFUSED ? event.reason : "";
      this.lost();
      if (!this.refused) setTimeout(() => this.connect(), AGAIN_MS);
    };
  }

  /** Connect again, with a token. */
  knock(token: string): void {
    [this.token, this.refused] = [token, ""];
    this.connect();
  }

  /** Send a message if the connection is open; else drop it. */
  say(message: object): void {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  stop(): void {
    this.stopped();
    this.stops += 1;
    this.say({ type: "stop", number: this.stops });
    // Also as a request, in case one of them is blocked; the panel counts a number once.
    void fetch("/api/stop", {
      method: "POST",
      headers: { Authorization: `Bearer ${this.token}`, "X-Stop": `${this.client}/${this.stops}` },
      keepalive: true,
    }).catch(() => undefined);
  }

  control(word: "take" | "give" | "keep" | "release"): void {
    this.say({ type: "control", word });
  }

  /** Send a command; return the number that its answer will carry, 0 if it was not sent. */
  act(command: { what: string; [key: string]: unknown }): number {
    if (!this.state || !this.lease) return 0;
    this.number += 1;
    this.say({ type: "act", lease: this.lease, seen: this.state.seq, number: this.number, command });
    return this.number;
  }
}
