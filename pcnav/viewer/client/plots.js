// Plots over time with gaps, bands and a logarithmic axis on demand; all share their window of time.
(() => {
  const pcnav = window.pcnav, LEFT = 62, PAD = 10, FOOT = 34, TOP = 20, KEY = 84;
  let window_s = null, hover_s = null, drag = null, boxes = [];

  const spec = () => pcnav.data.plots || { charts: [], span: [0, 1] };
  const shown = () => window_s || spec().span;
  const warp = (chart) => (chart.linear ? (v) => Math.asinh(v / chart.linear) : (v) => v);

  // The vertical range of what lies in the window of time.
  const range = (chart) => {
    const [from, to] = shown();
    let low = Infinity, high = -Infinity;
    const see = (v) => { if (v !== null) { low = Math.min(low, v); high = Math.max(high, v); } };
    for (const line of chart.lines)
      line.t.forEach((t, k) => { if (t >= from && t <= to) see(line.v[k]); });
    for (const band of chart.bands)
      band.t.forEach((t, k) => { if (t >= from && t <= to) { see(band.low[k]); see(band.high[k]); } });
    if (chart.bound !== null) see(chart.bound);
    if (low > high) return [0, 1];
    if (low === high) { low -= Math.abs(low) * 0.1 || 1; high += Math.abs(high) * 0.1 || 1; }
    const f = warp(chart), pad = 0.05 * (f(high) - f(low));
    return [f(low) - pad, f(high) + pad];
  };
  const values = (chart, low, high, about) => {
    if (!chart.linear) {
      // One number alone is no scale.
      let found = [];
      for (let wanted = about; found.length < 2 && wanted < 8 * about; wanted *= 1.5)
        found = pcnav.ticks(low, high, wanted);
      return found.map((v) => [v, v]);
    }
    let found = [[0, 0]];
    const least = Math.round(Math.log10(chart.linear));
    const most = Math.floor(Math.log10(Math.max(chart.linear * Math.sinh(Math.max(high, -low)), chart.linear)));
    const step = Math.max(1, Math.ceil((most - least + 1) / Math.max(about / 2, 1)));
    for (let k = most; k >= least; k -= step) {
      found.push([Math.asinh(10 ** k / chart.linear), 10 ** k]);
      found.push([-Math.asinh(10 ** k / chart.linear), -(10 ** k)]);
    }
    found = found.filter(([at]) => at >= low && at <= high);
    // Near zero powers of ten lie closer than their numbers are high.
    const apart = (1.1 * (high - low)) / about / 2, kept = [];
    for (const tick of found) if (kept.every(([at]) => Math.abs(at - tick[0]) > apart)) kept.push(tick);
    return kept;
  };

  const drawOne = (box, chart, last) => {
    const pen = pcnav.fitted(box), [from, to] = shown(), right = box.clientWidth - PAD;
    const height = box.clientHeight - (last ? FOOT : 8) - TOP;
    pcnav.still(box, `${pcnav.versions.plots} ${from} ${to} ${last}`, (still) => paint(still, box, chart, last));
    const x = (t) => LEFT + ((t - from) / (to - from || 1)) * (right - LEFT);
    const mark = (t, share) => {
      if (t === null || t < from || t > to) return;
      pen.fillStyle = pcnav.isDark() ? `rgba(255,255,255,${share})` : `rgba(0,0,0,${share})`;
      pen.fillRect(x(t) - 0.5, TOP, 1.2, height);
    };
    mark(pcnav.data.now ? pcnav.data.now.time : null, 0.9);
    mark(hover_s, 0.35);
    if (drag) {
      pen.fillStyle = pcnav.ink(0.15);
      pen.fillRect(x(Math.min(...drag)), TOP, Math.abs(x(drag[1]) - x(drag[0])), height);
    }
  };
  const paint = (pen, box, chart, last) => {
    const width = box.clientWidth, foot = last ? FOOT : 8;
    const height = box.clientHeight - foot - TOP, [from, to] = shown(), [low, high] = range(chart);
    const f = warp(chart), right = width - PAD;
    const x = (t) => LEFT + ((t - from) / (to - from || 1)) * (right - LEFT);
    const y = (v) => TOP + (1 - (f(v) - low) / (high - low)) * height;
    const name = pcnav.readable;
    pen.fillStyle = pcnav.ink();
    pen.textAlign = "left";
    pen.fillText(chart.label, 8, 8, right);
    pen.textAlign = "right";
    const scale = values(chart, low, high, Math.max(height / 26, 3));
    // Numbers keep apart: where they would touch, every second one is left out, and zero stays
    // unless it would stand alone.
    const apart = scale.length > 1 ? (Math.abs(scale[1][0] - scale[0][0]) / (high - low)) * height : height;
    const zero = Math.max(scale.findIndex(([, value]) => value === 0), 0);
    const first = scale.length === 3 ? 0 : zero;
    const told = scale.filter((_, k) => chart.linear || apart >= 13 || scale.length < 3 || (k - first) % 2 === 0);
    for (const [at, value] of told) {
      const py = TOP + (1 - (at - low) / (high - low)) * height;
      pen.fillStyle = pcnav.ink(0.1);
      pen.fillRect(LEFT, py, right - LEFT, 1);
      pen.fillStyle = pcnav.ink(0.8);
      // Not into the name above, nor into the times below.
      pen.fillText(String(+value.toPrecision(4)), LEFT - 6, Math.min(Math.max(py, TOP + 5), TOP + height - 5));
    }
    pen.textAlign = "center";
    for (const t of pcnav.ticks(from, to, (right - LEFT) / 80)) {
      pen.fillStyle = pcnav.ink(0.1);
      pen.fillRect(x(t), TOP, 1, height);
      pen.fillStyle = pcnav.ink(0.8);
      if (last) pen.fillText(String(+t.toPrecision(6)), x(t), TOP + height + 10);
    }
    if (last) pen.fillText("time, s", (LEFT + right) / 2, TOP + height + 24);
    pen.save();
    pen.beginPath();
    pen.rect(LEFT, TOP, right - LEFT, height);
    pen.clip();
    for (const shade of chart.shades) {
      pen.fillStyle = shade.fill;
      for (const [a, b] of shade.spans) pen.fillRect(x(a), TOP, Math.max(x(b) - x(a), 1), height);
    }
    for (const band of chart.bands) {
      pen.fillStyle = band.fill;
      let start = 0;
      const close = (end) => {
        if (end - start > 1) {
          pen.beginPath();
          for (let k = start; k < end; k++) pen.lineTo(x(band.t[k]), y(band.high[k]));
          for (let k = end - 1; k >= start; k--) pen.lineTo(x(band.t[k]), y(band.low[k]));
          pen.fill();
        }
        start = end + 1;
      };
      for (let k = 0; k <= band.t.length; k++)
        if (k === band.t.length || band.high[k] === null || band.low[k] === null) close(k);
    }
    if (chart.bound !== null) {
      pen.strokeStyle = name("#e54729");
      pen.setLineDash([6, 4]);
      pen.beginPath();
      pen.moveTo(LEFT, y(chart.bound));
      pen.lineTo(right, y(chart.bound));
      pen.stroke();
      pen.setLineDash([]);
    }
    for (const line of chart.lines) {
      pen.strokeStyle = pen.fillStyle = name(line.colour);
      pen.lineWidth = 1.5;
      const alone = (k) => line.v[k - 1] == null && line.v[k + 1] == null;
      pen.beginPath();
      let down = false;
      line.t.forEach((t, k) => {
        const v = line.v[k];
        if (v === null) { down = false; return; }
        if (line.dots || alone(k)) { pen.fillRect(x(t) - 1.5, y(v) - 1.5, 3, 3); return; }
        if (down) pen.lineTo(x(t), y(v)); else pen.moveTo(x(t), y(v));
        down = true;
      });
      pen.stroke();
    }
    pen.restore();
  };
  const draw = () => {
    const { charts } = spec();
    boxes.forEach((box, k) => { if (charts[k] && box.clientWidth) drawOne(box, charts[k], k === charts.length - 1); });
  };

  // What is nearest in time to the pointer, of every line.
  const told = (chart, t) => {
    const lines = [`${(+t.toPrecision(6))} s`];
    for (const line of chart.lines) {
      let best = -1, near = Infinity;
      line.t.forEach((at, k) => {
        if (line.v[k] !== null && Math.abs(at - t) < near) { near = Math.abs(at - t); best = k; }
      });
      if (best >= 0 && near < 0.02 * (shown()[1] - shown()[0]) + 1e-9)
        lines.push(`${line.name}: ${+line.v[best].toPrecision(4)}`);
    }
    return lines.join("\n");
  };
  const build = () => {
    const place = document.querySelector(".pcnav-plots"), { charts } = spec();
    boxes = [];
    if (!place) return;
    place.replaceChildren();
    // All of them and what their lines mean, down to the time line, unless they became too low.
    const room = innerHeight - pcnav.footHeight() - place.getBoundingClientRect().top - FOOT - KEY;
    const each = Math.min(190, Math.max(72, room / Math.max(charts.length, 1)));
    charts.forEach((chart, k) => {
      const box = document.createElement("canvas");
      box.style.height = `${each + (k === charts.length - 1 ? FOOT - 8 : 0)}px`;
      place.append(box);
      boxes.push(box);
      const time = (event) => {
        const left = box.getBoundingClientRect().left, [from, to] = shown();
        return from + ((event.clientX - left - LEFT) / (box.clientWidth - LEFT - PAD)) * (to - from);
      };
      box.onpointerdown = (event) => { drag = [time(event), time(event)]; box.setPointerCapture(event.pointerId); };
      box.onpointermove = (event) => {
        hover_s = time(event);
        if (drag) drag[1] = hover_s;
        pcnav.showTip(event.clientX, event.clientY, told(spec().charts[k], hover_s));
        draw();
      };
      box.onpointerleave = () => { hover_s = null; pcnav.showTip(0, 0, ""); draw(); };
      box.onpointerup = () => {
        const [a, b] = [Math.min(...drag), Math.max(...drag)], [from, to] = shown();
        drag = null;
        if (b - a > 0.02 * (to - from)) window_s = [Math.max(a, spec().span[0]), Math.min(b, spec().span[1])];
        else pcnav.say({ do: "seek", time: a });
        draw();
      };
      box.ondblclick = () => { window_s = null; draw(); };
    });
    draw();
  };
  const taken = () => {
    const [from, to] = spec().span;
    if (window_s && (window_s[0] < from || window_s[1] > to)) window_s = null;
    if (boxes.length !== spec().charts.length || boxes.some((box) => !box.isConnected)) build();
    else draw();
  };
  const shows = new ResizeObserver(() => draw());
  shows.observe(document.body);
  pcnav.plots = { draw, taken, build, window: () => shown(), close: () => shows.disconnect() };
  build();
})();
