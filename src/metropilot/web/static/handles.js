// Handles on the speed limits and stations of a line that is edited: dragged along the line, or up and down.
(() => {
  const EDGE_PX = 12, LEVEL_PX = 18, STATION_PX = 24, GRID_KMH = 5, GRID_M = 10, FINE_M = 1, FINE_M_PER_PX = 0.5;

  const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

  class Handles extends MetropilotPicture {
    constructor(root, chart) { super(root, chart); this.held = null; this.all = []; }

    // At their places wherever the picture is drawn anew; hidden where they are out of it.
    place() {
      const el = document.getElementById("c" + this.chart), full = el && el._fullLayout;
      if (!full || !full.yaxis || !full.yaxis._length) return;
      this.x = full.xaxis; this.y = full.yaxis;
      this.told = (el.layout.meta || {}).handles || [];
      while (this.all.length > this.told.length) this.all.pop().remove();
      while (this.all.length < this.told.length) this.all.push(this.make(this.all.length));
      this.told.forEach((told, k) => {
        const handle = this.all[k];
        if (handle.parentElement !== el) el.append(handle);
        handle.dataset.kind = told.kind; handle.dataset.row = told.row;
        this.put(handle, this.held && this.held.k === k ? { ...told, ...this.held.at } : told);
      });
    }

    make(k) { return this.handle("mp-handle", (e) => this.take(e, k)); }

    put(handle, told) {
      const along = (m) => this.x.d2p(m / 1000), up = (kmh) => this.y.d2p(kmh), width = this.x._length, height = this.y._length;
      let left, right, top, bottom;
      if (told.kind === "speed") {
        [left, right] = [clamp(along(told.from_m), 0, width), clamp(along(told.to_m), 0, width)];
        [top, bottom] = [up(told.kmh) - LEVEL_PX / 2, up(told.kmh) + LEVEL_PX / 2];
      } else if (told.kind === "from") {
        [left, right] = [along(told.from_m) - EDGE_PX / 2, along(told.from_m) + EDGE_PX / 2];
        [top, bottom] = [up(Math.max(told.kmh, told.before_kmh)), up(Math.min(told.kmh, told.before_kmh))];
      } else {
        [left, right] = [along(told.from_m) - STATION_PX / 2, along(told.from_m) + STATION_PX / 2];
        [top, bottom] = [height - STATION_PX, height];
      }
      handle.hidden = right <= 0 || left >= width || right <= left || bottom < -LEVEL_PX || top > height + LEVEL_PX;
      const at = { left: this.x._offset + left, width: right - left, top: this.y._offset + top, height: Math.max(bottom - top, EDGE_PX) };
      for (const [name, px] of Object.entries(at)) handle.style[name] = `${px}px`;
    }

    take(e, k) {
      const told = this.told[k], level = told.kind === "speed";
      const offset = level ? e.clientY - this.y.d2p(told.kmh) : e.clientX - this.x.d2p(told.from_m / 1000);
      const value = level ? told.kmh : told.from_m;
      this.held = { k, told, level, offset, at: {}, value, sent: value, first: true };
    }

    move(e) {
      const held = this.held;
      if (!held) return;
      const { told, level } = held;
      if (level) {
        const top = Math.floor(Math.max(...this.y.range) / GRID_KMH) * GRID_KMH;
        held.value = clamp(MetropilotPicture.snap(this.y.p2d(e.clientY - held.offset), GRID_KMH), GRID_KMH, top);
        held.at = { kmh: held.value };
      } else {
        const grid = (1000 * (this.x.range[1] - this.x.range[0])) / this.x._length > FINE_M_PER_PX ? GRID_M : FINE_M;
        held.value = clamp(MetropilotPicture.snap(1000 * this.x.p2d(e.clientX - held.offset), grid), told.least_m, told.most_m);
        held.at = { from_m: held.value };
      }
      this.all[held.k].dataset.value = level ? `${held.value} km/h` : `${held.value} m`;
      this.put(this.all[held.k], { ...told, ...held.at });
      this.soon(() => this.send(false));
    }

    leave() {
      if (!this.held) return;
      this.send(true);
      delete this.all[this.held.k].dataset.value;
      this.held = null;
    }

    // One change that can be undone: the first of its events begins it, the last one fills the tables.
    send(done) {
      const held = this.held;
      if (!held || (held.value === held.sent && (!done || held.first))) return;
      const detail = { kind: held.told.kind, row: held.told.row, value: held.value, first: held.first, done };
      held.sent = held.value; held.first = false;
      this.root.dispatchEvent(new CustomEvent("mp-handle", { detail, bubbles: true }));
    }
  }

  let handles = null;
  window.metropilotHandles = (rootId, chart) => {
    const root = document.getElementById(rootId);
    if (!handles || handles.root !== root) handles = new Handles(root, chart);
    handles.place();
  };
})();
