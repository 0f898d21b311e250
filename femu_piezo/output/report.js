"use strict";
(() => {
  const NS = "http://www.w3.org/2000/svg";
  const WIDTH = 860, LEFT = 78, RIGHT = 14, TOP = 8, BOTTOM = 42;
  const groups = {};
  let count = 0;

  function make(parent, tag, attributes, text) {
    const node = document.createElementNS(NS, tag);
    for (const key in attributes) node.setAttribute(key, attributes[key]);
    if (text !== undefined) node.textContent = text;
    parent.appendChild(node);
    return node;
  }

  function scale(axis, range, from, to) {
    const turn = axis.log ? Math.log10 : (value) => value;
    const low = turn(range[0]), high = turn(range[1]);
    const map = (value) => from + (to - from) * (turn(value) - low) / (high - low);
    map.inverse = (place) => {
      const value = low + (high - low) * (place - from) / (to - from);
      return axis.log ? 10 ** value : value;
    };
    return map;
  }

  function ticks(axis, range, wanted) {
    if (axis.log && range[1] > 8 * range[0]) {
      const decades = Math.log10(range[1] / range[0]);
      const factors = decades < 1.6 ? [1, 2, 5] : [1];
      const every = Math.max(1, Math.ceil(decades / wanted));
      const found = [];
      for (let power = Math.floor(Math.log10(range[0])); power <= Math.log10(range[1]); power += every)
        for (const factor of factors) found.push(factor * 10 ** power);
      return found.filter((value) => value >= range[0] * 0.9999 && value <= range[1] * 1.0001);
    }
    const rough = (range[1] - range[0]) / wanted, power = 10 ** Math.floor(Math.log10(rough));
    const step = power * [1, 2, 5, 10].find((factor) => factor * power >= rough);
    const found = [];
    for (let index = Math.ceil(range[0] / step - 1e-9); index * step <= range[1] + 1e-9 * step; index++)
      found.push(index * step);
    return found;
  }

  function written(value) {
    if (value === 0) return "0";
    const size = Math.abs(value);
    if (size >= 1e5 || size < 1e-3 || size === 1e4) {
      const [digits, power] = Number(value.toPrecision(4)).toExponential().split("e");
      const raised = String(Number(power)).replace(/./g, (c) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(c)]);
      return (digits === "1" ? "10" : digits === "-1" ? "−10" : digits.replace("-", "−") + "·10") + raised;
    }
    return String(Number(value.toPrecision(6))).replace("-", "−");
  }

  function extent(chart, range) {
    let low = Infinity, high = -Infinity;
    for (const one of chart.series)
      one.y.forEach((value, index) => {
        if (value === null || one.x[index] < range[0] || one.x[index] > range[1]) return;
        if (chart.y.log && value <= 0) return;
        low = Math.min(low, value);
        high = Math.max(high, value);
      });
    if (!(low <= high)) return chart.y.log ? [1, 10] : [0, 1];
    if (chart.y.log) return low * 1.02 < high ? [low * (low / high) ** 0.05, high * (high / low) ** 0.05] : [low / 2, high * 2];
    const room = (high - low || Math.abs(high) || 1) * 0.06;
    return [low - room, high + room];
  }

  function whole(group) {
    let low = Infinity, high = -Infinity;
    for (const chart of group.charts)
      for (const one of chart.series) {
        low = Math.min(low, one.x[0]);
        high = Math.max(high, one.x[one.x.length - 1]);
      }
    return [low, high];
  }

  function draw(chart) {
    const range = groups[chart.group].range, height = chart.height;
    const svg = chart.svg;
    svg.replaceChildren();
    chart.toX = scale(chart.x, range, LEFT, WIDTH - RIGHT);
    const vertical = chart.y.limits || extent(chart, range);
    const toY = scale(chart.y, vertical, height - BOTTOM, TOP);
    const box = {x: LEFT, y: TOP, width: WIDTH - LEFT - RIGHT, height: height - TOP - BOTTOM};
    make(make(make(svg, "defs", {}), "clipPath", {id: chart.clip}), "rect", box);
    const inside = make(svg, "g", {"clip-path": `url(#${chart.clip})`});
    for (const band of chart.bands) {
      const to = band.axis === "x" ? chart.toX : toY;
      const a = to(band.low), b = to(band.high), start = Math.min(a, b), size = Math.abs(b - a);
      make(inside, "rect", band.axis === "x" ? {x: start, width: size, y: TOP, height: box.height, fill: band.color}
        : {x: LEFT, width: box.width, y: start, height: size, fill: band.color});
    }
    for (const value of ticks(chart.x, range, 8)) {
      const x = chart.toX(value);
      make(svg, "line", {x1: x, x2: x, y1: TOP, y2: height - BOTTOM, class: "grid"});
      make(svg, "text", {x, y: height - BOTTOM + 15, "text-anchor": "middle"}, written(value));
    }
    for (const value of ticks(chart.y, vertical, Math.max(3, height / 60))) {
      const y = toY(value);
      make(svg, "line", {x1: LEFT, x2: WIDTH - RIGHT, y1: y, y2: y, class: "grid"});
      make(svg, "text", {x: LEFT - 6, y: y + 4, "text-anchor": "end"}, written(value));
    }
    make(svg, "rect", {...box, class: "frame"});
    make(svg, "text", {x: (LEFT + WIDTH - RIGHT) / 2, y: height - 8, "text-anchor": "middle"}, chart.x.label);
    make(svg, "text", {transform: `translate(14 ${TOP + box.height / 2}) rotate(-90)`, "text-anchor": "middle"}, chart.y.label);
    svg.appendChild(inside);
    for (const one of chart.series) {
      const steps = [];
      let pen = "M";
      one.y.forEach((value, index) => {
        if (value === null || (chart.y.log && value <= 0) || one.x[index] <= 0 && chart.x.log) { pen = "M"; return; }
        const place = `${chart.toX(one.x[index]).toFixed(2)} ${toY(value).toFixed(2)}`;
        steps.push(one.kind === "points" ? `M${place}h0` : pen + place);
        pen = "L";
      });
      make(inside, "path", {d: steps.join(""), stroke: one.color, class: one.kind});
    }
    chart.brush = make(inside, "rect", {y: TOP, height: box.height, width: 0, class: "brush"});
  }

  function show(group, range) {
    group.range = range;
    group.charts.forEach(draw);
  }

  function place(chart, event) {
    const box = chart.svg.getBoundingClientRect();
    const x = (event.clientX - box.left) * WIDTH / box.width;
    return Math.min(Math.max(x, LEFT), WIDTH - RIGHT);
  }

  function readout(chart, x) {
    const at = chart.toX.inverse(x), parts = [];
    let shown = null;
    for (const one of chart.series) {
      let best = 0;
      one.x.forEach((value, index) => { if (Math.abs(value - at) < Math.abs(one.x[best] - at)) best = index; });
      shown = shown === null ? one.x[best] : shown;
      if (one.y[best] !== null) parts.push(`${one.name} ${written(Number(one.y[best].toPrecision(5)))}`);
    }
    chart.words.textContent = `${written(shown)} · ${parts.join(" · ")}`;
  }

  function listen(chart) {
    const group = groups[chart.group];
    let start = null;
    chart.svg.addEventListener("pointerdown", (event) => {
      start = place(chart, event);
      chart.svg.setPointerCapture(event.pointerId);
      event.preventDefault();
    });
    chart.svg.addEventListener("pointermove", (event) => {
      const x = place(chart, event);
      readout(chart, x);
      if (start === null) return;
      chart.brush.setAttribute("x", Math.min(start, x));
      chart.brush.setAttribute("width", Math.abs(x - start));
    });
    chart.svg.addEventListener("pointerup", (event) => {
      const x = place(chart, event), from = start;
      start = null;
      if (from === null) return;
      if (Math.abs(x - from) < 5) { chart.brush.setAttribute("width", 0); return; }
      show(group, [chart.toX.inverse(Math.min(from, x)), chart.toX.inverse(Math.max(from, x))]);
    });
    chart.svg.addEventListener("dblclick", () => show(group, whole(group)));
  }

  function legend(chart, figure) {
    const line = document.createElement("div");
    line.className = "legend";
    const names = [...chart.series, ...chart.bands];
    for (const one of names) {
      const mark = document.createElement("i");
      mark.style.background = one.color;
      mark.className = one.kind || "band";
      const entry = document.createElement("span");
      entry.append(mark, one.name);
      line.append(entry);
    }
    figure.append(line);
  }

  function buttons(chart, figure) {
    const line = document.createElement("div");
    line.className = "views";
    const views = {"whole sweep": null, ...chart.views};
    for (const name in views) {
      const button = document.createElement("button");
      button.textContent = name;
      button.type = "button";
      button.addEventListener("click", () => show(groups[chart.group], views[name] || whole(groups[chart.group])));
      line.append(button);
    }
    line.append("drag to zoom, double click for the whole sweep");
    figure.append(line);
  }

  for (const figure of document.querySelectorAll("figure.chart")) {
    const chart = JSON.parse(figure.querySelector("script").textContent);
    chart.clip = `clip-${count++}`;
    const first = !(chart.group in groups);
    const group = groups[chart.group] = groups[chart.group] || {charts: []};
    group.charts.push(chart);
    if (first) buttons(chart, figure);
    legend(chart, figure);
    chart.svg = make(figure, "svg", {viewBox: `0 0 ${WIDTH} ${chart.height}`, role: "img"});
    chart.words = document.createElement("div");
    chart.words.className = "readout";
    figure.append(chart.words);
    const caption = figure.querySelector("figcaption");
    if (caption) figure.append(caption);
    listen(chart);
  }
  for (const name in groups) show(groups[name], whole(groups[name]));
})();
