// Reads the few protobuf messages of Foxglove that the page shows. The numbers of the fields are those of Foxglove's schemas.

const text = new TextDecoder();

// Calls `field(number, value)` for every field: a number, or the bytes of text, bytes, messages and packed numbers.
function eachField(bytes, field) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  let at = 0;
  const varint = () => {
    let value = 0;
    for (let factor = 1; at < bytes.length; factor *= 128) {
      const byte = bytes[at++];
      value += (byte & 127) * factor;
      if (byte < 128) return value;
    }
    throw new Error("a message is cut off");
  };
  while (at < bytes.length) {
    const key = varint();
    const number = Math.floor(key / 8);
    switch (key % 8) {
      case 0: field(number, varint()); break;
      case 1: field(number, view.getFloat64(at, true)); at += 8; break;
      case 2: {
        const length = varint();
        if (at + length > bytes.length) throw new Error("a message is cut off");
        field(number, bytes.subarray(at, at + length));
        at += length;
        break;
      }
      case 5: field(number, view.getUint32(at, true)); at += 4; break;
      default: throw new Error("not a protobuf message");
    }
  }
}

function vector(bytes) {
  const numbers = [0, 0, 0, 0];
  eachField(bytes, (number, value) => { numbers[number - 1] = value; });
  return numbers;
}

function pose(bytes) {
  const read = { x: 0, y: 0, yaw: 0 };
  eachField(bytes, (number, value) => {
    if (number === 1) [read.x, read.y] = vector(value);
    if (number === 2) {
      const [, , z, w] = vector(value);
      read.yaw = 2 * Math.atan2(z, w);
    }
  });
  return read;
}

function doubles(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  return Float64Array.from({ length: bytes.length / 8 }, (_, at) => view.getFloat64(8 * at, true));
}

// foxglove.Grid
export function grid(bytes) {
  const read = { x: 0, y: 0, columns: 0, cell: 0, stride: 1, rowStride: 0, data: new Uint8Array() };
  eachField(bytes, (number, value) => {
    if (number === 3) ({ x: read.x, y: read.y } = pose(value));
    if (number === 4) read.columns = value;
    if (number === 5) [read.cell] = vector(value);
    if (number === 6) read.rowStride = value;
    if (number === 7) read.stride = value;
    if (number === 9) read.data = value;
  });
  read.rows = read.rowStride ? Math.floor(read.data.length / read.rowStride) : 0;
  return read;
}

// foxglove.LaserScan
export function scan(bytes) {
  const read = { start: 0, end: 0, ranges: [] };
  eachField(bytes, (number, value) => {
    if (number === 4) read.start = value;
    if (number === 5) read.end = value;
    if (number === 6) read.ranges = doubles(value);
  });
  return read;
}

// foxglove.PosesInFrame
export function path(bytes) {
  const poses = [];
  eachField(bytes, (number, value) => { if (number === 3) poses.push(pose(value)); });
  return poses;
}

// foxglove.SceneUpdate with entities of closed lines: the corners of each line, by the names of the entities.
export function areas(bytes) {
  const entities = {};
  eachField(bytes, (number, entity) => {
    if (number !== 2) return;
    const areas = [];
    eachField(entity, (number, line) => {
      if (number === 3) entities[text.decode(line)] = areas;
      if (number !== 11) return;
      const corners = [];
      eachField(line, (number, point) => {
        if (number !== 5) return;
        const [x, y] = vector(point);
        corners.push({ x, y });
      });
      areas.push(corners);
    });
  });
  return entities;
}

// foxglove.CompressedImage
export function image(bytes) {
  let data = new Uint8Array();
  eachField(bytes, (number, value) => { if (number === 2) data = value; });
  return data;
}

// foxglove.Log
export function log(bytes) {
  const read = { level: 0, message: "" };
  eachField(bytes, (number, value) => {
    if (number === 2) read.level = value;
    if (number === 3) read.message = text.decode(value);
  });
  return read;
}

// foxglove.FrameTransforms: where the scanner is on the robot.
export function laser(bytes) {
  let found = null;
  eachField(bytes, (number, value) => {
    let child = "";
    let place = [0, 0, 0, 0];
    if (number !== 1) return;
    eachField(value, (number, value) => {
      if (number === 3) child = text.decode(value);
      if (number === 4) place = vector(value);
    });
    if (child === "laser") found = { x: place[0], y: place[1] };
  });
  return found;
}

export function json(bytes) {
  return JSON.parse(text.decode(bytes));
}
