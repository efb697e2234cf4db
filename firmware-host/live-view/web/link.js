// A client of Foxglove's WebSocket protocol: subscribes by topic, calls services by name, and connects again when the link ends.

const RETRY_MS = 500;
const ANSWERS_WITHIN_MS = 3000;

export class Link {
  // `readers`: functions by topic, each called with the payload and the time. `events`: open(role), closed(), robot(text or null).
  constructor(url, readers, events) {
    Object.assign(this, { url, readers, events });
    this.calls = new Map();
    this.nextCall = 1;
    this.connect();
  }

  connect() {
    this.services = new Map();
    this.topics = new Map();
    this.socket = new WebSocket(this.url, ["foxglove.sdk.v1"]);
    this.socket.binaryType = "arraybuffer";
    this.socket.onmessage = ({ data }) => {
      if (typeof data === "string") this.text(JSON.parse(data));
      else this.binary(new DataView(data));
    };
    this.socket.onclose = () => {
      for (const call of this.calls.values()) call.fail("the link is lost");
      this.calls.clear();
      this.events.closed();
      setTimeout(() => this.connect(), RETRY_MS);
    };
  }

  text(message) {
    switch (message.op) {
      case "serverInfo": this.events.open(message.metadata?.role ?? "watch"); break;
      case "advertise": this.subscribe(message.channels); break;
      case "advertiseServices":
        for (const { id, name } of message.services) this.services.set(name, id);
        break;
      case "status": this.events.status(message.message, message.id === "robot"); break;
      case "removeStatus": this.events.status(null, true); break;
      case "serviceCallFailure": this.answer(message.callId, { accepted: false, text: message.message }); break;
    }
  }

  subscribe(channels) {
    const wanted = channels.filter(({ topic }) => topic in this.readers);
    for (const { id, topic } of wanted) this.topics.set(id, topic);
    const subscriptions = wanted.map(({ id }) => ({ id, channelId: id }));
    this.socket.send(JSON.stringify({ op: "subscribe", subscriptions }));
  }

  binary(view) {
    const bytes = new Uint8Array(view.buffer);
    if (view.getUint8(0) === 1) {
      const topic = this.topics.get(view.getUint32(1, true));
      if (topic) this.readers[topic](bytes.subarray(13), Number(view.getBigUint64(5, true) / 1000000n));
    } else if (view.getUint8(0) === 3) {
      const start = 13 + view.getUint32(9, true);
      this.answer(view.getUint32(5, true), JSON.parse(new TextDecoder().decode(bytes.subarray(start))));
    }
  }

  answer(id, answer) {
    this.calls.get(id)?.done(answer);
    this.calls.delete(id);
  }

  // Calls a service; the promise always ends with {accepted, text}.
  call(name, request = {}) {
    const service = this.services.get(name);
    if (this.socket.readyState !== WebSocket.OPEN || service === undefined) {
      return Promise.resolve({ accepted: false, text: "there is no link to the robot, or this client may not do that" });
    }
    const id = this.nextCall++;
    const payload = new TextEncoder().encode(JSON.stringify(request));
    const bytes = new Uint8Array(17 + payload.length);
    const view = new DataView(bytes.buffer);
    view.setUint8(0, 2);
    [service, id, 4].forEach((number, at) => view.setUint32(1 + 4 * at, number, true));
    bytes.set([0x6a, 0x73, 0x6f, 0x6e], 13); // "json"
    bytes.set(payload, 17);
    this.socket.send(bytes);
    return new Promise((done) => {
      const fail = (text) => done({ accepted: false, text });
      this.calls.set(id, { done, fail });
      setTimeout(() => fail("no answer within 3 s"), ANSWERS_WITHIN_MS);
    });
  }

  // Ends a connection that has gone silent; `onclose` opens the next one.
  restart() {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.close();
  }
}
