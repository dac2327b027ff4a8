// Plays the scenes: one canvas each, drawn from the numbers that the page carries. No library.
const SCENES = JSON.parse(document.getElementById("scenes").textContent);
const COLOURS = { wall: "#4a5568", thing: "#bec6cf", person: "#f08a4b", edge: "#c26126", robot: "#2563eb", goal: "#f5b800" };

function boundsOf(scene) {
  // What the robot and its goal need, and people near them; walls may be cut.
  const xs = scene.robot.map(p => p[0]).concat([scene.goal[0]]), ys = scene.robot.map(p => p[1]).concat([scene.goal[1]]);
  for (const [corners, wall] of scene.boxes) if (!wall) for (const c of corners) { xs.push(c[0]); ys.push(c[1]); }
  const pad = 2.2;
  return [Math.min(...xs) - pad, Math.min(...ys) - pad, Math.max(...xs) + pad, Math.max(...ys) + pad];
}

function player(card, scene) {
  const canvas = card.querySelector("canvas"), slider = card.querySelector("input");
  const button = card.querySelector("button"), clock = card.querySelector(".clock");
  const [x0, y0, x1, y1] = boundsOf(scene), upright = (y1 - y0) > 1.4 * (x1 - x0);
  const across = upright ? y1 - y0 : x1 - x0, up = upright ? x1 - x0 : y1 - y0;
  canvas.width = 760; canvas.height = Math.round(760 * up / across);
  const scale = 760 / across, draw = canvas.getContext("2d");
  // A tall corridor lies on its side: y to the right, x downwards.
  const at = (x, y) => upright ? [(y - y0) * scale, (x - x0) * scale] : [(x - x0) * scale, (y1 - y) * scale];
  const disc = (x, y, r, fill, stroke) => {
    const [px, py] = at(x, y);
    draw.beginPath(); draw.arc(px, py, Math.max(r * scale, 1), 0, 7);
    if (fill) { draw.fillStyle = fill; draw.fill(); }
    if (stroke) { draw.strokeStyle = stroke; draw.lineWidth = 2; draw.stroke(); }
  };
  slider.max = scene.robot.length - 1;
  function show(k) {
    slider.value = k;
    draw.fillStyle = "#fff"; draw.fillRect(0, 0, canvas.width, canvas.height);
    for (const [corners, wall] of scene.boxes) {
      draw.beginPath();
      corners.forEach((c, n) => n ? draw.lineTo(...at(...c)) : draw.moveTo(...at(...c)));
      draw.closePath(); draw.fillStyle = wall ? COLOURS.wall : COLOURS.thing; draw.fill();
    }
    for (const [x, y, r] of scene.pillars) disc(x, y, r, COLOURS.thing);
    disc(scene.goal[0], scene.goal[1], .3, "#fdf0c4", COLOURS.goal);
    draw.beginPath(); draw.strokeStyle = COLOURS.robot; draw.lineWidth = 2.5;
    for (let n = 0; n <= k; n++) { const p = at(scene.robot[n][0], scene.robot[n][1]); n ? draw.lineTo(...p) : draw.moveTo(...p); }
    draw.stroke();
    for (const [x, y, r] of scene.people[k]) disc(x, y, r, COLOURS.person, COLOURS.edge);
    const [x, y, yaw] = scene.robot[k];
    disc(x, y, .18, COLOURS.robot);
    draw.beginPath(); draw.moveTo(...at(x, y)); draw.lineTo(...at(x + .4 * Math.cos(yaw), y + .4 * Math.sin(yaw)));
    draw.strokeStyle = COLOURS.robot; draw.lineWidth = 4; draw.stroke();
    clock.textContent = Math.min(k * scene.frame_s, scene.duration_s).toFixed(1) + " s";
  }
  let playing = null;
  const stop = () => { clearInterval(playing); playing = null; button.textContent = "play"; };
  button.onclick = () => {
    if (playing) return stop();
    if (+slider.value >= scene.robot.length - 1) slider.value = 0;
    button.textContent = "pause";
    playing = setInterval(() => {
      if (+slider.value >= scene.robot.length - 1) return stop();
      show(+slider.value + 1);
    }, 1000 * scene.frame_s / 2); // twice as fast as life
  };
  slider.oninput = () => { stop(); show(+slider.value); };
  show(Math.floor((scene.robot.length - 1) * .6));
}
document.querySelectorAll("[data-scene]").forEach(card => player(card, SCENES[+card.dataset.scene]));
