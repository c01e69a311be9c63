// What a page shows beside viser's own parts: a status bar above, a time line below, cards, keys.
// The server sends JSON by channel; what the user does is written into viser's hidden text field.
(() => {
  if (window.pcnav) window.pcnav.close();

  // Told by the picture that this script arrived with.
  const session = this.alt;
  const GUTTER = 104, RIGHT = 64, SEND_EVERY_MS = 60, ASK_EVERY_MS = 1000, LOOK_EVERY_MS = 300;
  // Of an address; the server takes messages of 4000 characters.
  const MAX_STATE = 1500;
  // The panel with image and plots.
  const PANEL = ".mantine-ScrollArea-content:has(.pcnav-plots)";
  const LIGHT_INKS = '.mantine-ScrollArea-content :is(td, b)[style^="color:#"], .pcnav-known span, .pcnav-key span, .pcnav-note';
  const IMAGE = `${PANEL} img:not([src="data:,"])`;
  const data = {}, versions = {};
  const ends = [];
  let pointer = [200, 200];

  const make = (tag, id, parent = document.body) => {
    const made = document.createElement(tag);
    if (id) made.id = id;
    parent.append(made);
    return made;
  };
  const on = (target, event, what, options) => {
    target.addEventListener(event, what, options);
    ends.push(() => target.removeEventListener(event, what, options));
  };
  const isDark = () =>
    document.documentElement.getAttribute("data-mantine-color-scheme") !== "light";
  const ink = (share = 1) => (isDark() ? `rgba(200,204,212,${share})` : `rgba(40,44,52,${share})`);

  // Colours are those of a dark page; on a light one texts and lines are darker.
  const readable = (colour) => (isDark() ? colour : colour.replace(/^#(..)(..)(..)$/, (_, ...rgb) =>
    `rgb(${rgb.slice(0, 3).map((each) => Math.round(parseInt(each, 16) * 0.62)).join(",")})`));

  // To the server: one message at a time, since the field holds but the last.
  // It is asked to open what the address says until it confirms that it has; all else waits.
  const waiting = [];
  let sent = 0, timer = null, isOpened = false;
  const request = () => ({ do: "open", session, state: location.search.slice(1, 1 + MAX_STATE) });
  const field = () =>
    document.querySelector("[data-floating-window]:has(.pcnav-bridge) input");
  const pump = () => {
    timer = null;
    const input = field();
    if (isOpened && !waiting.length) return;
    if (input) {
      const next = isOpened ? waiting.shift() : request();
      const message = JSON.stringify({ n: ++sent, at: Date.now(), ...next });
      Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set.call(input, message);
      input.dispatchEvent(new Event("input", { bubbles: true }));
    }
    timer = setTimeout(pump, !input ? LOOK_EVERY_MS : isOpened ? SEND_EVERY_MS : ASK_EVERY_MS);
  };
  const say = (message) => {
    const last = waiting[waiting.length - 1];
    if (last && last.do === message.do) waiting.pop();
    waiting.push(message);
    if (timer === null) timer = setTimeout(pump, 0);
  };

  const style = make("style", "pcnav-style", document.head);
  const bar = make("div", "pcnav-status");
  const foot = make("div", "pcnav-time");
  const canvas = make("canvas", null, foot);
  const tip = make("div", "pcnav-tip");
  const card = make("div", "pcnav-card");
  const help = make("div", "pcnav-help");
  const top = () => 8 + 26 * (data.now ? data.now.rows.length : 1);
  const footHeight = () => 50 + (data.timeline ? data.timeline.runs : [])
    .reduce((sum, run) => sum + 16 + 21 * run.bars.length, 0);

  const layOut = () => {
    style.textContent = `
      #root { position: fixed; left: 0; right: 0; top: ${top()}px; bottom: ${footHeight()}px;
              height: auto !important; }
      [data-floating-window]:has(.pcnav-bridge) { display: none !important; }
      #pcnav-status, #pcnav-time, #pcnav-card, #pcnav-help, #pcnav-tip {
        font: 12px/1.4 system-ui, sans-serif; color: ${ink()};
        background: ${isDark() ? "#1b1c20" : "#f4f5f7"}; }
      #pcnav-status { position: fixed; left: 0; right: 0; top: 0; height: ${top()}px; display: flex;
        align-items: center; gap: 18px; padding: 0 12px; white-space: nowrap; overflow: hidden;
        box-sizing: border-box; border-bottom: 1px solid ${ink(0.2)}; }
      #pcnav-status .row { display: flex; gap: 18px; align-items: center; height: 26px; }
      #pcnav-status b { font-weight: 600; }
      #pcnav-status i { font-style: normal; opacity: .7; margin-right: 5px; }
      #pcnav-status .chip { padding: 1px 9px; border-radius: 9px; color: #14151a; }
      #pcnav-status .bad { outline: 2px solid #e54729; outline-offset: 2px; border-radius: 3px; }
      #pcnav-status input { width: 52px; background: transparent; color: inherit; font: inherit;
        border: 1px solid ${ink(0.35)}; border-radius: 3px; padding: 0 4px; text-align: right; }
      #pcnav-time { position: fixed; left: 0; right: 0; bottom: 0; height: ${footHeight()}px;
        border-top: 1px solid ${ink(0.2)}; }
      #pcnav-time canvas { width: 100%; height: 100%; display: block; cursor: pointer; }
      #pcnav-tip { position: fixed; display: none; pointer-events: none; padding: 3px 8px;
        border: 1px solid ${ink(0.35)}; border-radius: 4px; z-index: 400; white-space: pre; }
      #pcnav-card, #pcnav-help { position: fixed; display: none; padding: 8px 12px; z-index: 300;
        border: 1px solid ${ink(0.35)}; border-radius: 6px; max-width: 360px; }
      #pcnav-help { left: 50%; top: 50%; transform: translate(-50%, -50%); max-width: none; }
      #pcnav-card td, #pcnav-help td { padding-right: 12px; vertical-align: top; }
      #pcnav-card td:first-child, #pcnav-help td:first-child { opacity: .7; white-space: nowrap; }
      /* Image and plots at once on a low screen, too. */
      ${IMAGE} { max-height: 25vh; object-fit: contain; cursor: crosshair; }
      /* Not below the bar that scrolls the panel. */
      ${PANEL} { padding-right: 10px; }
      /* As the lines of plots, by "readable": swatches of the scene keep the colours that it has. */
      ${isDark() ? "" : `${LIGHT_INKS} { filter: brightness(0.62); }`}
      .pcnav-plots canvas { display: block; width: 100%; cursor: crosshair; }`;
  };

  const table = (box, title, rows, close) => {
    box.replaceChildren();
    const head = make("div", null, box);
    make("b", null, head).textContent = title;
    const cross = make("span", null, head);
    cross.textContent = "×";
    cross.style.cssText = "float:right;cursor:pointer;padding-left:16px;font-size:16px";
    cross.onclick = close;
    const grid = make("table", null, box);
    for (const [name, value] of rows) {
      const row = make("tr", null, grid);
      make("td", null, row).textContent = name;
      make("td", null, row).textContent = value;
    }
    box.style.display = "block";
  };
  const hideCard = () => { card.style.display = "none"; say({ do: "closed" }); };
  const hideHelp = () => { help.style.display = "none"; };

  const showTip = (x, y, text) => {
    tip.style.display = text ? "block" : "none";
    if (!text) return;
    tip.textContent = text;
    const { width, height } = tip.getBoundingClientRect();
    tip.style.left = `${Math.min(x + 12, innerWidth - width - 4)}px`;
    tip.style.top = `${Math.max(4, Math.min(y - height - 8, innerHeight - height - 4))}px`;
  };

  const drawStatus = () => {
    const now = data.now;
    if (!now) return;
    if (document.activeElement && document.activeElement.id === "pcnav-frame") return;
    bar.replaceChildren();
    const lines = make("div", null, bar);
    for (const [item, row] of now.rows.flatMap((items) => {
      const row = make("div", null, lines);
      row.className = "row";
      return items.map((item) => [item, row]);
    })) {
      const box = make("span", null, row);
      box.title = item.title || "";
      if (item.bad) box.className = "bad";
      if (item.label) make("i", null, box).textContent = item.label;
      const value = make(item.chip ? "span" : "b", null, box);
      if (item.chip) { value.className = "chip"; value.style.background = item.colour; }
      else if (item.colour) value.style.color = readable(item.colour);
      value.textContent = item.value;
    }
    const box = make("span", null, bar);
    if (noticed) {
      const told = make("i", null, box);
      told.textContent = "no graphics card";
      told.title = "The browser draws by the processor: slower. Its settings say why.";
      told.style.marginRight = "18px";
    }
    box.style.marginLeft = "auto";
    make("i", null, box).textContent = "frame";
    const input = make("input", "pcnav-frame", box);
    input.value = String(now.frame);
    input.onkeydown = (event) => {
      event.stopPropagation();
      if (event.key !== "Enter") return;
      say({ do: "frame", frame: parseInt(input.value, 10) || 0 });
      input.blur();
    };
    make("span", null, box).textContent = ` of ${now.last} · ${now.time.toFixed(2)} s`;
    const ask = make("span", null, bar);
    ask.textContent = "?";
    ask.title = "keys";
    ask.style.cssText = "cursor:pointer;padding:0 6px";
    ask.onclick = toggleHelp;
  };
  const toggleHelp = () => {
    if (help.style.display === "block") hideHelp();
    else table(help, "Keys", data.help || [], hideHelp);
  };

  // The time line.
  const scale = () => {
    const [from, to] = data.timeline.span, width = canvas.clientWidth - GUTTER - RIGHT;
    return { x: (t) => GUTTER + ((t - from) / (to - from || 1)) * width,
             t: (x) => from + ((x - GUTTER) / width) * (to - from) };
  };
  const rows = () => {
    const found = [];
    let top = 20;
    data.timeline.runs.forEach((run, k) => {
      found.push({ run, k, kind: "strip", top, height: 12 });
      top += 16;
      for (const bars of run.bars) {
        found.push({ run, k, kind: "bars", bars, top, height: 18 });
        top += 21;
      }
    });
    return found;
  };
  const fitted = (what) => {
    const ratio = devicePixelRatio || 1, { clientWidth: w, clientHeight: h } = what;
    if (what.width !== Math.round(w * ratio) || what.height !== Math.round(h * ratio)) {
      what.width = Math.round(w * ratio);
      what.height = Math.round(h * ratio);
    }
    const pen = what.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, w, h);
    pen.font = "11px system-ui, sans-serif";
    pen.textBaseline = "middle";
    return pen;
  };
  // What stays while time goes by is painted once, and laid below what moves.
  const still = (what, key, paint) => {
    const { width, height } = what, ratio = devicePixelRatio || 1;
    const told = `${width} ${height} ${ratio} ${isDark()} ${key}`;
    if (what.still === undefined) what.still = document.createElement("canvas");
    if (what.stillKey !== told) {
      what.stillKey = told;
      what.still.width = width;
      what.still.height = height;
      const pen = what.still.getContext("2d");
      pen.setTransform(ratio, 0, 0, ratio, 0, 0);
      pen.font = "11px system-ui, sans-serif";
      pen.textBaseline = "middle";
      paint(pen);
    }
    const pen = what.getContext("2d");
    if (width && height) pen.drawImage(what.still, 0, 0, width / ratio, height / ratio);
  };
  const ticks = (from, to, about) => {
    const raw = (to - from) / Math.max(about, 1) || 1, power = 10 ** Math.floor(Math.log10(raw));
    const step = power * [1, 2, 5, 10].find((s) => s * power >= raw * 0.999);
    const found = [];
    for (let t = Math.ceil(from / step - 1e-9) * step; t <= to + 1e-9 * step; t += step)
      found.push(Math.abs(t) < 1e-9 * step ? 0 : t);
    return found;
  };
  const drawTime = () => {
    if (!data.timeline || !canvas.clientWidth) return;
    const pen = fitted(canvas), { x } = scale(), bottom = canvas.clientHeight - 24;
    still(canvas, `timeline ${versions.timeline}`, paintTime);
    if (data.now) {
      const at = x(data.now.time);
      pen.fillStyle = isDark() ? "#fff" : "#000";
      pen.fillRect(at - 0.5, 0, 1.2, bottom);
      pen.beginPath();
      pen.arc(at, bottom, 6, 0, 7);
      pen.fill();
    }
  };
  const paintTime = (pen) => {
    const { x } = scale(), [from, to] = data.timeline.span;
    const right = canvas.clientWidth - RIGHT, bottom = canvas.clientHeight - 24;
    for (const row of rows()) {
      pen.textAlign = "right";
      pen.fillStyle = row.kind === "strip" ? readable(row.run.colour) : ink(0.8);
      const name = row.kind === "strip" ? row.run.name : row.bars.name;
      pen.fillText(name, GUTTER - 8, row.top + row.height / 2, GUTTER - 12);
      if (row.kind === "strip") {
        for (const [a, b, colour] of row.run.status) {
          pen.fillStyle = colour;
          pen.fillRect(x(a), row.top, Math.max(x(b) - x(a), 1), row.height);
        }
        continue;
      }
      pen.fillStyle = ink(0.06);
      pen.fillRect(GUTTER, row.top, right - GUTTER, row.height);
      row.bars.values.forEach((value, k) => {
        if (value === null) return;
        const a = x(row.bars.edges[k]), b = x(row.bars.edges[k + 1]);
        const height = Math.min(value / row.bars.top, 1) * row.height;
        pen.fillStyle = row.bars.bound !== null && value > row.bars.bound ? "#e54729" : row.run.colour;
        pen.fillRect(a, row.top + row.height - height, Math.max(b - a - (b - a > 8 ? 0.5 : 0), 1), Math.max(height, 1));
      });
      pen.textAlign = "left";
      pen.fillStyle = ink(0.6);
      pen.fillText(row.bars.scale, right + 6, row.top + row.height / 2, RIGHT - 8);
    }
    data.timeline.events.forEach((event) => {
      const at = x(event.time);
      pen.fillStyle = event.colour;
      pen.beginPath();
      pen.moveTo(at - 4, 5);
      pen.lineTo(at + 4, 5);
      pen.lineTo(at, 15);
      pen.fill();
    });
    pen.fillStyle = ink(0.7);
    pen.textAlign = "right";
    pen.fillText("events", GUTTER - 8, 10);
    pen.strokeStyle = ink(0.3);
    pen.beginPath();
    pen.moveTo(GUTTER, bottom);
    pen.lineTo(right, bottom);
    pen.stroke();
    pen.textAlign = "center";
    for (const t of ticks(from, to, (right - GUTTER) / 90)) {
      pen.fillRect(x(t), bottom, 1, 4);
      pen.fillText(String(+t.toPrecision(6)), x(t), bottom + 13);
    }
    pen.textAlign = "right";
    pen.fillText("time, s", GUTTER - 8, bottom + 2);
  };
  // Events under the pointer, the nearest first: marks of one frame lie on each other.
  const eventsAt = (px, py) => {
    if (py > 19) return [];
    const { x } = scale(), away = (k) => Math.abs(x(data.timeline.events[k].time) - px);
    return data.timeline.events.map((_, k) => k).filter((k) => away(k) < 7)
      .sort((a, b) => away(a) - away(b) || a - b);
  };
  const MAX_TOLD = 8;
  const within = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const seek = (event) => say({ do: "seek", time: scale().t(within(event)[0]) });
  let dragging = false, visited = -1;
  on(canvas, "pointerdown", (event) => {
    if (!data.timeline) return;
    const at = eventsAt(...within(event));
    if (at.length) {
      // Each click at the same marks goes on to the next of them.
      visited = at[(at.indexOf(visited) + 1) % at.length];
      say({ do: "event", index: visited });
      return;
    }
    dragging = true;
    canvas.setPointerCapture(event.pointerId);
    seek(event);
  });
  on(canvas, "pointermove", (event) => {
    if (!data.timeline) return;
    if (dragging) seek(event);
    const [px, py] = within(event), at = eventsAt(px, py), t = scale().t(px);
    if (at.length) {
      const told = at.slice(0, MAX_TOLD).map((k) => data.timeline.events[k].text);
      if (at.length > MAX_TOLD) told.push(`and ${at.length - MAX_TOLD} more`);
      showTip(event.clientX, event.clientY, told.join("\n"));
      return;
    }
    const lines = [`${t.toFixed(2)} s`];
    for (const row of rows()) {
      if (row.kind === "strip") {
        const span = row.run.status.find(([a, b]) => a <= t && t < b);
        if (span) lines.push(`${row.run.name}: ${span[3]}`);
        continue;
      }
      const k = row.bars.edges.findIndex((edge) => edge > t) - 1, value = row.bars.values[k];
      if (value !== undefined && value !== null) lines.push(`${row.bars.name} ${+value.toPrecision(3)}`);
    }
    showTip(event.clientX, event.clientY, px < GUTTER ? "" : lines.join("\n"));
  });
  on(canvas, "pointerup", () => { dragging = false; });
  on(canvas, "pointerleave", () => showTip(0, 0, ""));

  const showCard = () => {
    const told = data.card;
    if (!told || !told.title) { card.style.display = "none"; return; }
    table(card, told.title, told.rows, hideCard);
    const { width, height } = card.getBoundingClientRect();
    card.style.left = `${Math.max(4, Math.min(pointer[0] + 14, innerWidth - width - 8))}px`;
    card.style.top = `${Math.max(top() + 4, Math.min(pointer[1] + 14, innerHeight - height - 8))}px`;
  };
  const setAddress = () => {
    // Not behind a #, which viser takes for a part of the server's address.
    if (location.search.slice(1) !== data.address) history.replaceState(null, "", `?${data.address}`);
  };

  const goOn = () => {
    if (isOpened || data.opened.session !== session) return;
    isOpened = true;
    clearTimeout(timer);
    timer = setTimeout(pump, SEND_EVERY_MS);
  };

  const drawAll = () => { layOut(); drawStatus(); drawTime(); if (pcnav.plots) pcnav.plots.draw(); };
  const shows = {
    now: () => { if (bar.clientHeight + 1 !== top()) { layOut(); if (pcnav.plots) pcnav.plots.build(); } drawStatus(); drawTime(); if (pcnav.plots) pcnav.plots.draw(); },
    timeline: () => { layOut(); drawTime(); },
    plots: () => { if (pcnav.plots) pcnav.plots.taken(); },
    card: showCard,
    address: setAddress,
    opened: goOn,
    help: () => {},
  };
  const take = (channel, text) => {
    data[channel] = JSON.parse(text);
    versions[channel] = (versions[channel] || 0) + 1;
    shows[channel]();
  };

  // viser's notice that there is no graphics card lies over the scene until it is closed: the bar
  // says it instead.
  let noticed = false;
  const notice = setInterval(() => {
    for (const each of document.querySelectorAll(".mantine-Notification-root")) {
      if (!/Software WebGL/.test(each.textContent)) continue;
      const close = each.querySelector("button");
      if (close) close.click();
      noticed = true;
      clearInterval(notice);
      drawStatus();
    }
  }, 200);
  setTimeout(() => clearInterval(notice), 20000);

  on(window, "resize", () => drawAll());
  on(document, "pointerup", (event) => {
    pointer = [event.clientX, event.clientY];
    // A button that keeps the focus would be pressed again by the space bar.
    const pressed = event.target.closest && event.target.closest("button");
    if (pressed) setTimeout(() => pressed.blur(), 0);
  }, true);
  on(document, "click", (event) => {
    if (!event.target.matches || !event.target.matches(IMAGE)) return;
    const { left, top: above, width, height } = event.target.getBoundingClientRect();
    const { naturalWidth: w, naturalHeight: h } = event.target;
    // Where it is lower than its panel is wide, it stands in the middle.
    const scale = Math.min(width / w, height / h);
    const x = ((event.clientX - left - width / 2) / scale + w / 2) / w;
    const y = ((event.clientY - above - height / 2) / scale + h / 2) / h;
    if (x >= 0 && x <= 1 && y >= 0 && y <= 1) say({ do: "image", x, y });
  });
  on(document, "keydown", (event) => {
    if (/^(INPUT|TEXTAREA|SELECT)$/.test(event.target.tagName)) return;
    if (event.key === "?") toggleHelp();
    if (event.key === "Escape") { hideHelp(); if (card.style.display === "block") hideCard(); }
    if ([" ", "ArrowLeft", "ArrowRight", "Home", "End"].includes(event.key)) event.preventDefault();
  });
  // The arrows move through time; viser, which listens farther out, would move its camera as well.
  on(document.documentElement, "keydown", (event) => {
    if (event.key.startsWith("Arrow")) event.stopPropagation();
  });
  const watch = new MutationObserver(() => drawAll());
  watch.observe(document.documentElement, { attributeFilter: ["data-mantine-color-scheme"] });

  const close = () => {
    ends.forEach((end) => end());
    watch.disconnect();
    clearTimeout(timer);
    clearInterval(notice);
    [style, bar, foot, tip, card, help].forEach((each) => each.remove());
    if (window.pcnav.plots) window.pcnav.plots.close();
    window.dispatchEvent(new Event("resize"));
  };
  const pcnav = { data, versions, say, take, close, fitted, still, ticks, ink, isDark, readable, showTip, footHeight };
  window.pcnav = pcnav;
  layOut();
  window.dispatchEvent(new Event("resize"));
  timer = setTimeout(pump, 0);
})();
