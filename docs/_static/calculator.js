// Gains of a sampled loop on its drives, by the searches of cnclik.gains: the page "Which gain" has the theory.
// All poles ζ solve D(ζ) + s N(ζ) = 0, s the share of an error that a step removes.
"use strict";
const cnclik = (() => {
  // --- polynomials, lowest power first ----------------------------------------------------------------
  const times = (p, q) => {
    const r = Array(p.length + q.length - 1).fill(0);
    p.forEach((a, i) => q.forEach((b, j) => { r[i + j] += a * b; }));
    return r;
  };
  const plus = (p, q) => Array.from({ length: Math.max(p.length, q.length) }, (_, i) => (p[i] || 0) + (q[i] || 0));
  const scaled = (p, a) => p.map((c) => c * a);
  const real = (p, x) => p.reduceRight((sum, c) => sum * x + c, 0);
  const complex = (p, x, y) => {
    let re = 0, im = 0;
    for (let i = p.length - 1; i >= 0; i--) [re, im] = [re * x - im * y + p[i], re * y + im * x];
    return [re, im];
  };
  const divide = ([a, b], [c, d]) => { const n = c * c + d * d; return [(a * c + b * d) / n, (b * c - a * d) / n]; };

  /** All roots but those at 0, as [re, im] (Aberth and Ehrlich 1973). */
  function roots(p) {
    p = p.slice(p.findIndex((c) => c !== 0));
    while (p.length > 1 && p[p.length - 1] === 0) p.pop();
    const n = p.length - 1, slope = p.slice(1).map((c, i) => c * (i + 1));
    const size = Math.pow(Math.abs(p[0] / p[n]), 1 / Math.max(n, 1));
    const z = Array.from({ length: n }, (_, i) => {
      const angle = (2 * Math.PI * i) / n + 0.4;
      return [size * Math.cos(angle), size * Math.sin(angle)];
    });
    for (let round = 0, moved = 1; round < 60 && moved > 1e-14; round++) {
      moved = 0;
      for (let i = 0; i < n; i++) {
        const value = complex(p, ...z[i]);
        if (!value[0] && !value[1]) continue;
        let [re, im] = divide(complex(slope, ...z[i]), value);
        for (let j = 0; j < n; j++) if (j !== i) {
          const x = z[i][0] - z[j][0], y = z[i][1] - z[j][1], d = x * x + y * y || 1e-300;
          re -= x / d; im += y / d;
        }
        const [x, y] = divide([1, 0], [re, im]);
        if (!isFinite(x + y)) continue;
        z[i] = [z[i][0] - x, z[i][1] - y];
        moved = Math.max(moved, Math.hypot(x, y) / (1e-30 + Math.hypot(...z[i])));
      }
    }
    return z;
  }

  // --- a sampled drive: x[k+1] = Φ x[k] + Γ₀ u[k−d] + Γ₁ u[k−d−1], q = x₀ ---------------------------------
  const product = (a, b) => a.map((row) => b[0].map((_, j) => row.reduce((sum, v, k) => sum + v * b[k][j], 0)));
  const identity = (n) => Array.from({ length: n }, (_, i) => Array.from({ length: n }, (_, j) => +(i === j)));

  function exponential(a) {
    const norm = Math.max(...a.map((row) => row.reduce((sum, v) => sum + Math.abs(v), 0)));
    const halvings = Math.max(0, Math.ceil(Math.log2(norm || 1)) + 2);
    a = a.map((row) => scaled(row, 2 ** -halvings));
    let sum = identity(a.length), term = sum;
    for (let k = 1; k <= 16; k++) {
      term = product(term, a).map((row) => scaled(row, 1 / k));
      sum = sum.map((row, i) => plus(row, term[i]));
    }
    for (let k = 0; k < halvings; k++) sum = product(sum, sum);
    return sum;
  }

  /** Φ and ∫Φ b over a time h, from one exponential (Van Loan 1978). */
  function held(a, b, h) {
    const whole = exponential([...a.map((row, i) => scaled([...row, b[i]], h)), Array(a.length + 1).fill(0)]);
    return [whole.slice(0, -1).map((row) => row.slice(0, -1)), whole.slice(0, -1).map((row) => row[a.length])];
  }

  function sampled(drive, Ts) {
    const whole = Math.floor(drive.delay), share = drive.delay - whole;
    if (!drive.lag && !drive.frequency) return { phi: [[1]], now: [Ts * (1 - share)], late: [Ts * share], whole };
    const w = drive.frequency;
    let a = w ? [[0, w], [-w, -2 * drive.damping * w]] : [[-1 / drive.lag]], b = w ? [0, w] : [1 / drive.lag];
    if (drive.command !== "position") {
      a = [[0, 1, ...Array(a.length - 1).fill(0)], ...a.map((row) => [0, ...row])];
      b = [0, ...b];
    }
    const [phi, now] = held(a, b, Ts * (1 - share)), [first, late] = held(a, b, Ts * share);
    return { phi: product(phi, first), now, late: phi.map((row) => row.reduce((sum, v, k) => sum + v * late[k], 0)), whole };
  }

  /** G(ζ) = [numerator, denominator, polynomial of Φ], by Faddeev and Le Verrier. */
  function transfer({ phi, now, late, whole }) {
    const n = phi.length, P = Array(n + 1).fill(0), first = Array(n).fill(0), then = Array(n).fill(0);
    P[n] = 1;
    for (let k = 1, M = identity(n); k <= n; k++) {
      first[n - k] = M[0].reduce((sum, v, i) => sum + v * now[i], 0);
      then[n - k] = M[0].reduce((sum, v, i) => sum + v * late[i], 0);
      M = product(phi, M);
      P[n - k] = -M.reduce((sum, row, i) => sum + row[i], 0) / k;
      M = M.map((row, i) => row.map((v, j) => v + (i === j) * P[n - k]));
    }
    return [plus([0, ...first], then), [...Array(whole + 1).fill(0), ...P], P];
  }

  // --- the loop -----------------------------------------------------------------------------------------
  const positions = (drive) => drive.command === "position" && (drive.lag > 0 || drive.frequency > 0);
  const kept = (drive, Ts) => (drive.cutoff ? Math.exp(-2 * Math.PI * drive.cutoff * Ts) : drive.smoothing || 0);

  /** The drive as the loop sees it: its own commands have no drive. */
  const within = (drive) => drive.feedback !== "commanded" ? drive
    : drive.smoothed === "error" ? { delay: 0, smoothing: drive.smoothing, cutoff: drive.cutoff, smoothed: "error" } : { delay: 0 };

  /** ℓ = N/D with 1 + s ℓ(ζ) = 0 at all poles. */
  function loop(drive, Ts) {
    const model = sampled(drive, Ts), [B, A, own] = transfer(model);
    const rho = ["error", "command"].includes(drive.smoothed) ? kept(drive, Ts) : 0;
    const f = rho ? [0, 1 - rho] : [1], g = rho ? [-rho, 1] : [1];
    let N = times(B, f), D = times(A, g);
    if (drive.feedback === "rebased")
      D = drive.smoothed === "command" ? plus(D, scaled(N, -1)) : times(g, plus(A, scaled(B, -1)));
    else if (positions(drive)) { N = [0, ...N]; D = times(D, [-1, 1]); } else N = scaled(N, 1 / Ts);
    return { N, D, model, rho, own };
  }

  const poles = ({ N, D }, s) => roots(plus(D, scaled(N, s)));

  /** The smallest x in (0, reach] from which holds(x); inf if there is none. */
  function firstBeyond(holds, reach, points = 1024, halvings = 52) {
    let low = 0, high;
    const near = Math.min(reach, 10), far = Math.log(Math.max(reach, 10) / 10);
    for (let i = 1; i < 2 * points; i++) {
      const x = i <= points ? (near * i) / points : 10 * Math.exp((far * (i - points)) / (points - 1));
      if (i > points && reach <= 10) return Infinity;
      if (holds(x)) { high = x; break; }
      low = x;
    }
    if (high === undefined) return Infinity;
    for (let k = 0; k < halvings; k++) { const m = (low + high) / 2; if (holds(m)) high = m; else low = m; }
    return low;
  }

  /** The least −1/ℓ over the frequencies where ℓ is real and negative: the phase crossovers. */
  function stableShare(drive, Ts) {
    const L = loop(within(drive), Ts);
    const gain = (w) => divide(complex(L.N, Math.cos(w), Math.sin(w)), complex(L.D, Math.cos(w), Math.sin(w)));
    const grid = Array.from({ length: 1024 }, (_, i) => 1e-6 * (Math.PI / 1e-6) ** (i / 1023))
      .concat(Array.from({ length: 1024 }, (_, i) => 1e-3 + ((Math.PI - 1e-3) * i) / 1023)).sort((a, b) => a - b);
    let least = Infinity;
    const take = (w) => { const at = gain(w)[0]; if (at < 0) least = Math.min(least, -1 / at); };
    for (let i = 1, before = gain(grid[0])[1]; i < grid.length; i++) {
      const after = gain(grid[i])[1];
      if (before * after < 0) {
        let low = grid[i - 1], high = grid[i];
        for (let k = 0; k < 52; k++) { const m = (low + high) / 2; if (gain(m)[1] * before > 0) low = m; else high = m; }
        take((low + high) / 2);
      }
      before = after;
    }
    take(Math.PI);
    const small = 1e-4 * Math.min(least, 1);
    return poles(L, small).every((z) => Math.hypot(...z) < 1) ? least : 0;
  }

  /** The share with which the pole that starts at ζ = 1 meets another real one, or 0. */
  function doublePole({ N, D }) {
    const share = (rate) => -real(D, Math.exp(-rate)) / real(N, Math.exp(-rate));
    const grid = Array.from({ length: 1024 }, (_, i) => 1e-6 * (30 / 1e-6) ** (i / 1023)), values = grid.map(share);
    const i = values.findIndex((v, k) => k < 1023 && !(values[k + 1] >= v));
    if (i < 0) return values[1023];
    if (!(values[i + 1] >= 0 && values[i + 1] <= values[i])) return Infinity;
    let low = grid[Math.max(i - 1, 0)], high = grid[i + 1];
    for (let k = 0; k < 60; k++) {
      const third = (high - low) / 3;
      if (share(low + third) < share(high - third)) low += third; else high -= third;
    }
    return share((low + high) / 2);
  }

  /** Samples of the motion after the target has moved from 1 to 0. */
  function motion(drive, Ts, s, longest = 20000) {
    const { model, rho, own } = loop({ ...drive, feedback: drive.feedback === "rebased" ? "measured" : drive.feedback }, Ts);
    const inside = poles(loop(within(drive), Ts), s).map((z) => Math.hypot(...z));
    const slowest = Math.max(...inside, ...roots(own).map((z) => Math.hypot(...z)).filter((r) => r < 1 - 1e-9), 0);
    const wanted = slowest > 0 && slowest < 1 ? (2 * Math.log(1e-3)) / Math.log(slowest) : longest;
    const N = Math.trunc(Math.min(Math.max(wanted + 4 * drive.delay + 50, 50), longest)), out = [];
    const stepping = positions(drive), rest = +stepping;
    let x = model.phi.map((_, i) => +(i === 0)), line = Array(model.whole + 2).fill(rest), total = 1;
    let mean = rest * (drive.smoothed === "command");
    for (let k = 0; k <= N; k++) {
      out.push(x[0]);
      const seen = drive.feedback === "commanded" ? total : x[0];
      if (rho && drive.smoothed === "error") mean = rho * mean + (1 - rho) * seen;
      const step = -s * (rho && drive.smoothed === "error" ? mean : seen);
      total = (drive.feedback === "rebased" ? seen : total) + step;
      let command = stepping ? total : step / Ts;
      if (rho && drive.smoothed === "command") command = mean = rho * mean + (1 - rho) * command;
      line.unshift(command);
      line.pop();
      x = model.phi.map((row, i) => row.reduce((sum, v, j) => sum + v * x[j], 0)
        + model.now[i] * line[model.whole] + model.late[i] * line[model.whole + 1]);
    }
    return out;
  }

  const overshoot = (drive, Ts, s) => Math.max(0, -Math.min(...motion(drive, Ts, s)));

  function smoothShare(drive, Ts, stable) {
    if (!stable) return 0;
    const L = loop(within(drive), Ts);
    const swings = (s) => {
      const all = poles(L, s).map(([x, y]) => [x, y, Math.hypot(x, y)]), most = Math.max(...all.map((z) => z[2]), 0);
      return all.some(([x, y, r]) => r >= most * (1 - 1e-6) && r > 1e-9 && (x < 0 || Math.abs(y) > 1e-4 * r));
    };
    let share = Math.min(stable, doublePole(L));
    if (isFinite(share) && swings(share * (1 - 1e-6))) share = Math.min(share, firstBeyond(swings, share, 128, 40));
    if (!isFinite(share) || overshoot(drive, Ts, share) <= 0.01) return share;
    let low = 0, high = share;
    for (let k = 0; k < 12; k++) { const m = (low + high) / 2; if (overshoot(drive, Ts, m) > 0.01) high = m; else low = m; }
    return low;
  }

  /** Shares: stable; without overshoot; the same with one more sample of dead time. */
  function limits(drive, Ts) {
    const stable = stableShare(drive, Ts), smooth = smoothShare(drive, Ts, stable);
    const late = drive.feedback === "commanded" ? { ...within(drive), delay: 1 } : { ...drive, delay: Math.min(drive.delay + 1, 101) };
    let recommended = Math.min(smooth, smoothShare(late, Ts, Math.min(stable, stableShare(late, Ts))));
    if (drive.feedback === "rebased") {
      const inertias = drive.frequency ? [0.5, 2, 1] : [1];
      const each = inertias.map((h) => ({ ...late, frequency: drive.frequency / h ** 0.5, damping: drive.damping / h ** 0.5 }));
      if (!each.every((one) => stableShare(one, Ts))) recommended = 0;
    }
    return [stable, smooth, recommended];
  }

  // --- methods ------------------------------------------------------------------------------------------
  const METHODS = {
    EE: [[[0]], [1]], IE: [[[1]], [1]], CN: [[[0], [0, 1]], [0.5, 0.5]], TRAPEZOID: [[[0], [0.5, 0.5]], [0.5, 0.5]],
    HEUN: [[[0], [1, 0]], [0.5, 0.5]], MIDPOINT: [[[0], [0.5, 0]], [0, 1]],
    RK4: [[[0], [0.5, 0], [0, 0.5, 0], [0, 0, 1, 0]], [1 / 6, 1 / 3, 1 / 3, 1 / 6]], "EXP-MIDPOINT": null,
  };

  /** 1 − R(z); M passes, null: solved exactly. */
  function removed(method, z, M) {
    if (!METHODS[method]) return -Math.expm1(-z);
    const slopes = [], [A, b] = METHODS[method];
    for (const row of A) {
      const base = 1 + slopes.reduce((sum, k, i) => sum + (row[i] || 0) * k, 0), own = row[row.length - 1];
      let slope = -z * (M === null || !own ? base : 1);
      if (own && M === null) slope /= 1 + own * z;
      for (let k = 0; own && M !== null && k < M; k++) slope = -z * (base + own * slope);
      slopes.push(slope);
    }
    return -b.reduce((sum, weight, i) => sum + weight * slopes[i], 0);
  }

  function gainRemoving(share, method, M) {
    if (!share) return 0;
    if (!METHODS[method]) return share < 1 - 1e-12 ? -Math.log1p(-share) : Infinity;
    return firstBeyond((z) => { const taken = removed(method, z, M); return !(taken <= share && taken >= -1e-15); }, 1e6);
  }

  /** { stable, smooth, recommended } [1/s] of { delay [samples], lag, frequency, damping, command, feedback, … }. */
  function gains(drive, Ts, method = "EXP-MIDPOINT", M = null) {
    const [stable, smooth, recommended] = limits(drive, Ts).map((share) => gainRemoving(share, method, M));
    return { stable: stable / Ts, smooth: smooth / Ts, recommended: Math.min(recommended, 1) / Ts };
  }

  /** Settling time [s] and overshoot of a gain. */
  function response(drive, Ts, alpha, method, M) {
    const path = motion(drive, Ts, removed(method, alpha * Ts, M));
    let last = path.length - 1;
    while (last >= 0 && Math.abs(path[last]) <= 0.02) last--;
    return { settling: last === path.length - 1 ? Infinity : (last + 1) * Ts, overshoot: Math.max(0, -Math.min(...path)) };
  }

  /** The recommended gain of the same loop elsewhere, by explicit Euler: [where, its number, what it means]. */
  function elsewhere(drive, Ts) {
    const z = (one) => Math.min(1, limits(one, Ts)[2]) || null, ideal = !drive.lag && !drive.frequency;
    const velocity = !ideal && !positions(drive), measured = z({ ...drive, feedback: "measured" });
    const prompt = !drive.delay && !kept(drive, Ts) && drive.feedback !== "commanded";
    const servo = velocity || (ideal && !prompt) ? null : ideal ? 1 : z({ ...drive, command: "position", feedback: "rebased" });
    const look = { ...drive, feedback: "measured", command: "position" };
    if (ideal) look.lag = 0.03; else look.delay = Math.min(look.delay + 0.03 / Ts, 100);
    const ur = velocity ? null : z(look);
    return [
      ["pink, mink", measured, "gain per step, configuration measured"], ["Placo", measured, "share of the way per solve, state measured"],
      ["MoveIt Servo", measured && measured / Ts, "proportional gains [1/s], velocities published"],
      ["Isaac Lab", servo, "k_val, targets from the measured joints"],
      ["UR servoj", ur && ur / Ts, "alpha [1/s], lookahead_time 0.03, q_cmd += q̇ Ts"],
    ];
  }
  return { gains, response, limits, elsewhere, METHODS };
})();
if (typeof module !== "undefined") module.exports = cnclik;

// --- the page -------------------------------------------------------------------------------------------
if (typeof document !== "undefined") document.addEventListener("DOMContentLoaded", () => {
  const form = document.getElementById("loop"), answer = document.getElementById("answer");
  if (!form) return;
  const field = (name) => form.elements[name], number = (name) => Math.max(0, Number(field(name).value) || 0);
  const show = (x, digits = 4) => x === Infinity ? "any" : x ? `${Number(x.toPrecision(digits))}` : "none";
  let latest = 0;
  new URLSearchParams(location.hash.slice(1)).forEach((value, name) => { if (field(name)) field(name).value = value; });

  function read() {
    const Ts = Math.max(number("Ts"), 0.1) / 1e3, kind = field("drive").value, filter = field("smoothed").value;
    const command = field("command").value, rebased = command === "rebased";
    const drive = {
      delay: Math.min(number("dead") / 1e3 / Ts, 100), lag: kind === "lag" ? number("lag") / 1e3 : 0,
      frequency: kind === "servo" ? number("frequency") : 0, damping: number("damping") || 1,
      command: command === "velocity" ? "velocity" : "position", feedback: field("feedback").value,
      smoothing: filter === "none" ? 0 : Math.min(number("smoothing"), 0.999), smoothed: filter === "none" ? "error" : filter,
    };
    if (rebased && (drive.lag || drive.frequency)) drive.feedback = "rebased";
    const method = field("method").value, passes = field("M").value;
    return { drive, Ts, method, M: passes === "" ? null : Math.round(number("M")) };
  }

  function update() {
    const { drive, Ts, method, M } = read(), found = cnclik.gains(drive, Ts, method, M);
    for (const one of form.querySelectorAll("[data-for]"))
      one.hidden = !one.dataset.for.split(" ").includes(field(one.dataset.of).value);
    const did = found.recommended ? cnclik.response(drive, Ts, found.recommended, method, M) : null;
    const rows = [["largest stable", `${show(found.stable)} 1/s`], ["without overshoot", `${show(found.smooth)} 1/s`],
      ["recommended", `${show(found.recommended)} 1/s`]];
    if (did) rows.push(["settles to 2 % in", `${show(did.settling, 3)} s`], ["gain margin", show(found.stable / found.recommended, 3)]);
    const table = (lines) => lines.map(([name, ...cells]) => `<tr><th scope="row">${name}</th><td>${cells.join("</td><td>")}</td></tr>`).join("");
    answer.innerHTML = `<table>${table(rows)}</table><p>The same loop by explicit Euler elsewhere:</p><table>${
      table(cnclik.elsewhere(drive, Ts).map(([where, value, meaning]) => [where, show(value), meaning]))}</table>`;
    history.replaceState(null, "", `#${new URLSearchParams(new FormData(form))}`);
    chart(drive, method, M, Ts);
  }

  /** The recommended gain over sampling time and dead time, row by row. */
  function chart(drive, method, M, now) {
    const sampling = [0.5, 1, 2, 4, 8, 16, 32, 64], dead = [0, 5, 10, 20, 30, 50, 80], mine = ++latest;
    const late = drive.delay * now * 1e3, nearest = (list, x) => list.reduce((a, b) => (Math.abs(b - x) < Math.abs(a - x) ? b : a));
    const body = document.querySelector("#chart tbody");
    document.querySelector("#chart thead").innerHTML = `<tr><th>dead time</th>${sampling.map((T) => `<th>${T} ms</th>`).join("")}</tr>`;
    body.innerHTML = "";
    const row = (i) => {
      if (mine !== latest || i === dead.length) return;
      const cells = sampling.map((T) => {
        if (dead[i] / T > 100) return "<td></td>";
        const { recommended } = cnclik.gains({ ...drive, delay: dead[i] / T }, T / 1e3, method, M);
        const shade = recommended ? Math.min(Math.max(Math.log10(recommended) / 2.5, 0), 1) : 0;
        const here = T === nearest(sampling, now * 1e3) && dead[i] === nearest(dead, late);
        return `<td style="--shade:${(90 * shade).toFixed(0)}%"${here ? ' class="here" aria-current="true"' : ""}>${show(recommended, 2)}</td>`;
      });
      body.insertAdjacentHTML("beforeend", `<tr><th scope="row">${dead[i]} ms</th>${cells.join("")}</tr>`);
      setTimeout(row, 0, i + 1);
    };
    setTimeout(row, 0, 0);
  }
  form.addEventListener("input", update);
  form.addEventListener("submit", (event) => event.preventDefault());
  update();
});
