// The robot's health as a list of names and values; what the robot does not report is not shown.

const number = (value, unit, digits = 1) => (Number.isFinite(value) ? `${value.toFixed(digits)} ${unit}` : null);

function device(health) {
  if (!health?.state) return null;
  const rate = health.rate_hz > 0 ? `, ${health.rate_hz.toFixed(0)} Hz` : "";
  return { text: `${health.state}${rate}`, bad: health.state !== "working", problem: health.problem };
}

function recording(health) {
  const { folder, failure, dropped } = health.recording;
  if (failure) return { text: failure, bad: true };
  if (!folder) return { text: "off" };
  return { text: dropped > 0 ? `${dropped} ticks missing` : "on", bad: dropped > 0 };
}

function rows(health) {
  const { safety, power, exploration } = health;
  const free = health.disk_free_gib;
  return [
    ["Safety plane", { text: safety.state, bad: safety.state.startsWith("fault") }],
    ["Camera", device(health.camera)],
    ["LiDAR", device(health.lidar)],
    ["Base", device(health.base)],
    ["Battery", number(power.voltage_v, "V")],
    ["Current", number(power.current_a, "A")],
    ["Temperature", power.temperature_c == null ? null : { text: number(power.temperature_c, "\u00b0C", 0), bad: power.is_hot }],
    ["Mapped floor", number(exploration.mapped_m2, "m\u00b2")],
    ["Depth within 25 %", exploration.line ? `${(100 * exploration.line.delta1).toFixed(0)} %` : null],
    ["Model", exploration.model ? exploration.model.slice(0, 12) + (exploration.on_trial ? " (trial)" : "") : "none"],
    ["Tick, median / 99 %", `${exploration.tick_p50_ms.toFixed(0)} / ${exploration.tick_p99_ms.toFixed(0)} ms`],
    ["Stops for obstacles", `${safety.stops}`],
    ["Recording", recording(health)],
    ["Disk free", free == null ? null : { text: number(free, "GiB"), bad: free < 1 }],
    ["Running for", duration(health.uptime_s)],
  ];
}

function duration(seconds) {
  const minutes = Math.floor(seconds / 60);
  return minutes < 60 ? `${minutes} min ${Math.floor(seconds % 60)} s` : `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}

export function showHealth(list, health) {
  const elements = [];
  for (const [name, value] of rows(health)) {
    if (value == null) continue;
    const { text, bad, problem } = typeof value === "string" ? { text: value } : value;
    const term = document.createElement("dt");
    term.textContent = name;
    const entry = document.createElement("dd");
    entry.textContent = text;
    entry.classList.toggle("bad", Boolean(bad));
    elements.push(term, entry);
    if (problem) {
      const why = document.createElement("dd");
      why.className = "bad wide";
      why.textContent = problem;
      elements.push(why);
    }
  }
  list.replaceChildren(...elements);
}
