"use strict";
// Draws the report from the JSON in #content. Text that comes from the user's files reaches the page through textContent,
// or through `plain` where Plotly would read it as markup.
(() => {
  const content = JSON.parse(document.getElementById("content").textContent);
  const at = (id) => document.getElementById(id);
  const COLOURS = ["#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#8c6bb1"];
  const ON_DARK = ["#4aa3e0", "#E69F00", "#1fbf92", "#CC79A7", "#9fd6f5", "#b39ad6"];
  const GREY = "#8a94a0", WRONG = "#D55E00", PICK = "#ff2d8a", RESIDUAL = "#d81b60";
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const config = { responsive: true, displaylogo: false, displayModeBar: "hover", modeBarButtonsToRemove: ["select2d", "lasso2d", "toImage", "sendDataToCloud"] };
  const quiet = Object.assign({}, config, { displayModeBar: false });
  const plain = (text) => String(text).replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");
  const figure = (value, digits = 3) => (value === null || value === undefined ? "–" : Number(value.toPrecision(digits)).toString());
  const percent = (p) => (p === null || p === undefined ? null : p > 0.9999 ? "> 99.99 %" : p < 1e-4 ? "< 0.01 %" : (100 * p).toFixed(p > 0.99 || p < 0.01 ? 2 : 1) + " %");
  const state = { view: 0, scale: null, lit: null, whole: false, camera: null };

  const view = () => content.views[state.view];
  const colourOf = (label) => (label < 0 ? GREY : (dark.matches ? ON_DARK : COLOURS)[label % COLOURS.length]);
  const sourceName = (i) => content.sourceNames[i];
  const targetName = (j) => (j < 0 ? "unmatched" : content.targetNames[j]);

  function paper(extra) {
    const style = getComputedStyle(document.body);
    const line = style.getPropertyValue("--line"), text = style.getPropertyValue("--text");
    const axis = { gridcolor: line, zerolinecolor: line, linecolor: line };
    const layout = Object.assign({
      modebar: { bgcolor: "rgba(0,0,0,0)", color: line, activecolor: text },
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { color: text, size: 12 },
      margin: { l: 48, r: 12, t: 8, b: 40 }, showlegend: false, hovermode: "closest",
    }, extra);
    for (const name of ["xaxis", "yaxis"]) layout[name] = Object.assign({}, axis, extra[name]);
    return layout;
  }

  function hoverOf(i, j) {
    const v = view(), parts = [];
    if (i >= 0) parts.push(`source ${plain(sourceName(i))}`);
    if (j >= 0) parts.push(`target ${plain(targetName(j))}`); else if (i >= 0) parts.push("unmatched");
    if (i >= 0 && j >= 0) {
      if (v.residuals[i] !== null) parts.push(`residual ${figure(v.residuals[i])} σ`);
      if (v.confidence) parts.push(`confidence ${percent(v.confidence[i])}`);
    }
    return parts.join("<br>");
  }

  // Points of one side; `pairs` are [source or −1, target or −1] per drawn point.
  function pointTrace(points, pairs, options) {
    const space = points.length > 0 && points[0].length === 3;
    const colours = pairs.map(([i, j]) => (i < 0 || j < 0 ? GREY : view().wrong && view().wrong[i] ? WRONG : colourOf(view().motions[i])));
    const lit = pairs.map(([i, j]) => state.lit && ((i >= 0 && i === state.lit[0]) || (j >= 0 && j === state.lit[1])));
    const big = options.size || (space ? (points.length > 300 ? 4 : points.length > 80 ? 6 : 8) : 9);
    const trace = {
      x: points.map((p) => p[0]), y: points.map((p) => p[1]), mode: "markers", customdata: pairs,
      hovertext: pairs.map(([i, j]) => hoverOf(i, j)), hoverinfo: "text",
      marker: { color: colours.map((c, k) => (lit[k] ? PICK : c)), size: lit.map((on) => (on ? 1.8 * big : big)), symbol: options.symbol, line: { width: options.open ? 2 : 0 } },
    };
    if (space) { trace.type = "scatter3d"; trace.z = points.map((p) => p[2]); } else { trace.type = "scatter"; }
    return trace;
  }

  function segments(ends, colour, space, width) {
    const trace = { mode: "lines", type: space ? "scatter3d" : "scatter", hoverinfo: "skip", line: { color: colour, width: width || 2 }, x: [], y: [], connectgaps: false };
    if (space) trace.z = [];
    for (const [a, b] of ends) for (const p of [a, b, null]) { trace.x.push(p && p[0]); trace.y.push(p && p[1]); if (space) trace.z.push(p && p[2]); }
    return trace;
  }

  const along = (from, to, length) => { const d = from.map((value, k) => to[k] - value), l = Math.hypot(...d) || 1; return from.map((value, k) => value + (d[k] * Math.min(length, l)) / l); };
  const mean = (points) => points[0].map((_, k) => points.reduce((sum, p) => sum + p[k], 0) / points.length);
  const apart = (a, b) => Math.hypot(...a.map((value, k) => value - b[k]));
  const cameras = () => view().poses.filter((pose) => pose && pose.frustum);

  // The edges of each camera's pyramid from its image towards its centre: all of them, or as long as the points are wide.
  function edges(pose) {
    const [centre, ...corners] = pose.frustum, middle = mean(content.source);
    const length = state.whole ? Infinity : Math.max(...content.source.map((p) => apart(p, middle)));
    return corners.map((corner) => [corner, along(corner, centre, length)]);
  }

  function cameraTraces() {
    const v = view(), traces = [];
    for (const pose of cameras()) {
      const corners = pose.frustum.slice(1), rim = corners.map((corner, k) => [corner, corners[(k + 1) % corners.length]]);
      traces.push(segments([...rim, ...edges(pose)], colourOf(pose.motion), true, 3));
      const own = v.assignment.map((j, i) => [i, j]).filter(([i, j]) => j >= 0 && v.motions[i] === pose.motion && pose.seen[j]);
      if (own.length) traces.push(pointTrace(own.map(([, j]) => pose.seen[j]), own, { symbol: "diamond", size: 4 }));
      const lit = own.filter(([i, j]) => state.lit && (state.lit[0] >= 0 ? i === state.lit[0] : j === state.lit[1]));
      if (lit.length) traces.push(segments(lit.map(([i, j]) => [pose.seen[j], content.source[i]]), PICK, true, 4));
    }
    return traces;
  }

  // What has to be within the view of space, and where to look from: upright as in the image, from beside the camera.
  function framed(points, poses) {
    const shown = [...points, ...poses.flatMap((pose) => [...pose.frustum.slice(1), ...edges(pose).map(([, end]) => end)])];
    const low = [0, 1, 2].map((k) => Math.min(...shown.map((p) => p[k]))), high = [0, 1, 2].map((k) => Math.max(...shown.map((p) => p[k])));
    const rim = 0.05 * (Math.max(...high.map((value, k) => value - low[k])) || 1);
    return low.map((value, k) => [value - rim, high[k] + rim]);
  }

  function eye(points, pose) {
    if (!pose) return { eye: { x: 1.6, y: 1.6, z: 1.1 } };
    const unit = (d) => { const l = Math.hypot(...d) || 1; return d.map((value) => value / l); };
    const less = (a, b) => unit(a.map((value, k) => value - b[k])), [centre, one, two, , four] = pose.frustum;
    const back = less(centre, mean(points)), right = less(two, one), up = less(one, four);
    const from = unit(back.map((value, k) => 0.55 * value + 0.78 * right[k] + 0.32 * up[k])).map((value) => (state.whole ? 2.1 : 1.6) * value);
    return { eye: { x: from[0], y: from[1], z: from[2] }, up: { x: up[0], y: up[1], z: up[2] } };
  }

  function scene(points, poses) {
    const style = getComputedStyle(document.body), line = style.getPropertyValue("--line"), ranges = framed(points, poses);
    const axis = (title, k) => ({ title: { text: title }, range: ranges[k], gridcolor: line, zerolinecolor: line, backgroundcolor: "rgba(0,0,0,0)", nticks: 5 });
    return paper({ margin: { l: 0, r: 0, t: 0, b: 0 }, scene: { aspectmode: "data", xaxis: axis("x", 0), yaxis: axis("y", 1), zaxis: axis("z", 2), camera: state.camera || eye(points, poses[0]) } });
  }

  // What the marks of a plot mean: [sign, colour, words].
  function explain(id, entries) {
    at(id).replaceChildren(...entries.map(([sign, colour, words]) => {
      const item = document.createElement("span"), mark = document.createElement("b");
      mark.textContent = sign; mark.style.color = colour; item.append(mark, ` ${words}`);
      return item;
    }));
  }

  function imageLayout(side) {
    const style = getComputedStyle(document.body), line = style.getPropertyValue("--line");
    const axis = { gridcolor: line, zeroline: false, linecolor: line };
    const layout = paper({
      xaxis: Object.assign({ title: { text: side.image ? "x, px" : "x" }, constrain: "domain" }, axis),
      yaxis: Object.assign({ title: { text: side.image ? "y, px" : "y" }, scaleanchor: "x", constrain: "domain" }, axis),
    });
    if (side.extent) { layout.xaxis.range = [side.extent[0], side.extent[2]]; layout.yaxis.range = side.image ? [side.extent[3], side.extent[1]] : [side.extent[1], side.extent[3]]; }
    if (side.photo) layout.images = [{ source: side.photo, xref: "x", yref: "y", x: -0.5, y: -0.5, sizex: side.photoSize[0], sizey: side.photoSize[1], sizing: "stretch", layer: "below", opacity: 0.8 }];
    return layout;
  }

  function drawSource() {
    const v = view(), pairs = content.source.map((_, i) => [i, v.assignment[i]]), poses = cameras();
    const traces = [pointTrace(content.source, pairs, { symbol: "circle" })];
    const space = content.sourceSide.dimension === 3;
    if (space) traces.push(...cameraTraces());
    Plotly.react("source", traces, space ? scene(content.source, poses) : imageLayout(content.sourceSide), config);
    const own = colourOf(0), shown = poses.length > 0;
    explain("source-key", [
      ["●", own, "matched"], ["●", GREY, "unmatched"],
      ...(shown ? [["▱", own, "image"], ["◆", own, "its detections"], ["—", PICK, "line of sight of the point under the mouse"]] : []),
      ...(v.wrong ? [["●", WRONG, "wrong"]] : []),
    ]);
    at("whole-control").hidden = !shown;
    if (shown) at("whole-label").textContent = `zoom out to the camera, ${figure(poses[0].distance)} away`;
  }

  function drawTarget() {
    const v = view(), target = content.target, side = content.targetSide, owner = new Array(target.length).fill(-1);
    v.assignment.forEach((j, i) => { if (j >= 0) owner[j] = i; });
    const pairs = target.map((_, j) => [owner[j], j]);
    const space = side.dimension === 3, traces = [];
    const predicted = v.predicted || [];
    const drawn = predicted.map((p, i) => [p, i]).filter(([p]) => p);
    if (drawn.length) {
      const vectors = drawn.filter(([, i]) => v.assignment[i] >= 0).map(([p, i]) => {
        const d = target[v.assignment[i]], k = state.scale;
        return [d, d.map((value, axis) => value + k * (value - p[axis]))]; // detected less predicted
      });
      traces.push(segments(vectors, RESIDUAL, space, 2));
      const unseen = drawn.filter(([, i]) => v.assignment[i] < 0);
      if (unseen.length) traces.push(pointTrace(unseen.map(([p]) => p), unseen.map(([, i]) => [i, -1]), { symbol: space ? "circle-open" : "circle-open", open: true }));
      traces.push(pointTrace(drawn.map(([p]) => p), drawn.map(([, i]) => [i, v.assignment[i]]), { symbol: space ? "cross" : "cross-thin-open", open: true }));
    }
    traces.push(pointTrace(target, pairs, { symbol: "circle" }));
    Plotly.react("target", traces, space ? scene(target, []) : imageLayout(side), config);
    const own = colourOf(0);
    explain("target-key", [
      ["●", own, "matched"], ["●", GREY, "unmatched"],
      ...(drawn.length ? [["+", own, "predicted by the pose"], ["—", RESIDUAL, "residual, enlarged as the slider says"]] : []),
      ...(drawn.some(([, i]) => v.assignment[i] < 0) ? [["⊕", GREY, "predicted, not detected"]] : []),
      ...(v.wrong ? [["●", WRONG, "wrong"]] : []),
    ]);
  }

  function drawResiduals() {
    const v = view();
    const used = v.residuals.map((r, i) => [r, i]).filter(([r]) => r !== null).sort((a, b) => a[0] - b[0]);
    const squared = used.map(([r]) => r * r), share = used.map((_, k) => (k + 0.5) / used.length);
    const end = Math.max(10, ...squared) * 1.05, grid = Array.from({ length: 120 }, (_, k) => (end * k) / 119);
    const cdf = v.dimensions === 1 ? grid.map((x) => erf(Math.sqrt(x / 2))) : v.dimensions === 3 ? grid.map((x) => erf(Math.sqrt(x / 2)) - Math.sqrt((2 * x) / Math.PI) * Math.exp(-x / 2)) : grid.map((x) => 1 - Math.exp(-x / 2));
    Plotly.react("residuals", [
      { x: grid, y: cdf, mode: "lines", type: "scatter", hoverinfo: "skip", line: { color: GREY, dash: "dash" } },
      { x: squared, y: share, mode: "markers", type: "scatter", customdata: used.map(([, i]) => [i, v.assignment[i]]), hovertext: used.map(([, i]) => hoverOf(i, v.assignment[i])), hoverinfo: "text", marker: { color: used.map(([, i]) => colourOf(v.motions[i])), size: 7 } },
    ], paper({ xaxis: { title: { text: "squared residual, σ²" }, range: [0, end] }, yaxis: { title: { text: "share of the matches below" }, range: [0, 1.02] } }), quiet);
    at("residual-note").textContent = used.length ? v.fit : "This problem fits no pose, so there are no residuals of points.";
  }

  function erf(x) {
    const t = 1 / (1 + 0.3275911 * Math.abs(x));
    const y = 1 - (((((1.061405429 * t - 1.453152027) * t) + 1.421413741) * t - 0.284496736) * t + 0.254829592) * t * Math.exp(-x * x);
    return x < 0 ? -y : y;
  }

  function drawSupport() {
    const v = view(), used = v.assignment.map((j, i) => [j, i]).filter(([j]) => j >= 0);
    const names = used.map(([, i]) => plain(sourceName(i)));
    const base = { x: used.map((_, k) => k), customdata: used.map(([j, i]) => [i, j]), hovertext: used.map(([j, i]) => hoverOf(i, j)), hoverinfo: "text" };
    const traces = [Object.assign({ type: "bar", y: used.map(([, i]) => v.weights[i]), marker: { color: used.map(([, i]) => colourOf(v.motions[i])), opacity: 0.75 } }, base)];
    if (v.confidence) traces.push(Object.assign({ type: "scatter", mode: "markers", y: used.map(([, i]) => v.confidence[i]), marker: { color: RESIDUAL, symbol: "diamond", size: 7 } }, base));
    at("support-note").textContent = "Bars: weight of each match in the soft assignment." + (v.confidence ? " Diamonds: its confidence, the posterior probability that it is right." : "");
    const step = Math.max(1, Math.ceil(used.length / 24));
    Plotly.react("support", traces, paper({ xaxis: { tickvals: used.map((_, k) => k).filter((k) => k % step === 0), ticktext: names.filter((_, k) => k % step === 0) }, yaxis: { range: [0, 1.05] } }), quiet);
  }

  function cell(row, text, kind) { const td = document.createElement("td"); td.textContent = text; if (kind) td.className = kind; row.appendChild(td); }

  function drawTable() {
    const v = view(), several = new Set(v.motions.filter((m) => m >= 0)).size > 1;
    const columns = ["source", "target", "residual, σ", "weight"];
    if (v.confidence) columns.push("confidence");
    if (several) columns.push("motion");
    if (content.truth) columns.push("truth");
    const head = document.createElement("tr");
    for (const name of columns) { const th = document.createElement("th"); th.scope = "col"; th.textContent = name; head.appendChild(th); }
    at("table").tHead.replaceChildren(head);
    const rows = content.source.map((_, i) => {
      const row = document.createElement("tr"), j = v.assignment[i];
      row.dataset.source = i; row.dataset.target = j;
      cell(row, sourceName(i)); cell(row, j < 0 ? "–" : targetName(j)); cell(row, v.residuals[i] === null ? "–" : v.residuals[i].toFixed(2)); cell(row, j < 0 ? "–" : v.weights[i].toFixed(3));
      if (v.confidence) cell(row, percent(v.confidence[i]));
      if (several) cell(row, v.motions[i] < 0 ? "–" : String(v.motions[i]));
      if (content.truth) {
        const t = content.truth[i];
        cell(row, j === t ? (t < 0 ? "hidden" : "right") : t < 0 ? "has no image" : `is ${targetName(t)}`, j >= 0 && j !== t ? "wrong" : "");
      }
      row.addEventListener("mouseenter", () => light([i, j]));
      row.addEventListener("mouseleave", () => light(null));
      return row;
    });
    at("table").tBodies[0].replaceChildren(...rows);
  }

  function drawPoses() {
    const texts = view().poses.filter(Boolean).map((pose) => { const pre = document.createElement("pre"); pre.textContent = pose.text; return pre; });
    if (!texts.length) { const p = document.createElement("p"); p.className = "note"; p.textContent = "No pose: too few matches, or a problem that fits none."; texts.push(p); }
    at("poses").replaceChildren(...texts);
  }

  let pending = false;
  function light(pair) {
    state.lit = pair;
    for (const row of at("table").tBodies[0].rows) row.classList.toggle("lit", Boolean(pair) && ((pair[0] >= 0 && Number(row.dataset.source) === pair[0]) || (pair[1] >= 0 && Number(row.dataset.target) === pair[1])));
    if (pending) return;
    pending = true;
    requestAnimationFrame(() => { pending = false; keepCamera(); drawSource(); drawTarget(); });
  }

  // Plotly keeps the view that the mouse chose in the layout of the element, which `react` would replace.
  function keepCamera() { const layout = at("source").layout; if (layout && layout.scene && layout.scene.camera) state.camera = layout.scene.camera; }

  function drawHeader() {
    at("status").textContent = content.summary; at("status").className = `status ${content.status}`;
    // names between backticks are code
    at("advice").replaceChildren(...content.advice.split("`").map((part, k) => { const piece = document.createElement(k % 2 ? "code" : "span"); piece.textContent = part; return piece; }));
    at("tabs").replaceChildren(...content.views.map((v, k) => {
      const button = document.createElement("button");
      const odds = percent(v.probability);
      button.type = "button"; button.role = "tab"; button.textContent = odds ? `${v.title} · ${odds}` : v.title;
      button.setAttribute("aria-selected", String(k === state.view));
      button.addEventListener("click", () => { state.view = k; draw(); });
      return button;
    }));
    at("tabs").hidden = content.views.length < 2;
    at("differs").textContent = view().differs;
  }

  function scaleText() { at("scale-label").textContent = state.scale === 0 ? "not at all" : `${state.scale} times as long`; }

  function draw() {
    keepCamera(); drawHeader(); drawSource(); drawTarget(); drawResiduals(); drawSupport(); drawTable(); drawPoses();
  }

  function start() {
    at("source-title").textContent = content.sourceSide.title; at("target-title").textContent = content.targetSide.title;
    at("source-note").textContent = content.sourceSide.note;
    state.scale = content.scale; at("scale").value = state.scale; at("scale").max = Math.max(200, 2 * state.scale); scaleText();
    at("scale-control").hidden = !content.views.some((v) => (v.predicted || []).some(Boolean));
    at("scale").addEventListener("input", () => { state.scale = Number(at("scale").value); scaleText(); drawTarget(); });
    at("whole").addEventListener("change", () => { state.whole = at("whole").checked; state.camera = null; drawSource(); });
    draw();
    for (const id of ["source", "target", "residuals", "support"]) {
      at(id).on("plotly_hover", (event) => { const pair = event.points[0] && event.points[0].customdata; if (pair) light(pair); });
      at(id).on("plotly_unhover", () => light(null));
    }
    dark.addEventListener("change", draw);
    document.body.dataset.ready = "true";
  }
  start();
})();
