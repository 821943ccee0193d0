"use strict";
// The session in three dimensions: workspace, path by its clearance, worst places, and the arm at a moment. mm, z up.
function view3d(holder, session, dark) {
  const three = drawing;
  const ink = dark ? "#eceff3" : "#16181d";
  const soft = dark ? "#a8b1bd" : "#565d68";
  const wrong = dark ? "#ff8a4c" : "#c23b00";
  const [BACK, BOTH] = [1, 2];
  const went = dark ? "#8ab4f8" : "#0b57d0";
  const renderer = new three.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
  renderer.setPixelRatio(Math.min(2, window.devicePixelRatio));
  renderer.setClearColor(dark ? "#15181c" : "#ffffff");
  holder.replaceChildren(renderer.domElement);
  renderer.domElement.setAttribute("role", "img");
  renderer.domElement.setAttribute("aria-label", "Workspace, path, worst places and arm; turn it by dragging");
  const scene = new three.Scene();
  const camera = new three.PerspectiveCamera(35, 1, 5, 40000);
  camera.up.set(0, 0, 1);
  const controls = new three.OrbitControls(camera, renderer.domElement);
  scene.add(new three.HemisphereLight("#ffffff", "#8a97a8", 2.2));
  const sun = new three.DirectionalLight("#ffffff", 1.2);
  sun.position.set(-500, -800, 1500);
  scene.add(sun);

  const vectors = (flat) => {
    const out = [];
    for (let k = 0; k < flat.length; k += 3) out.push(new three.Vector3(flat[k], flat[k + 1], flat[k + 2]));
    return out;
  };
  const polyline = (points, colour, dashed) => {
    const material = dashed ? new three.LineDashedMaterial({ color: colour, dashSize: 14, gapSize: 10 }) : new three.LineBasicMaterial({ color: colour });
    const line = new three.Line(new three.BufferGeometry().setFromPoints(points), material);
    if (dashed) line.computeLineDistances();
    scene.add(line);
    return line;
  };
  const between = (mesh, a, b) => {
    const along = new three.Vector3().subVectors(b, a);
    mesh.position.addVectors(a, b).multiplyScalar(0.5);
    mesh.scale.set(1, Math.max(along.length(), 0.01), 1);
    mesh.quaternion.setFromUnitVectors(new three.Vector3(0, 1, 0), along.lengthSq() > 0 ? along.normalize() : new three.Vector3(0, 0, 1));
  };
  const rod = (radius, colour) => {
    const mesh = new three.Mesh(new three.CylinderGeometry(radius, radius, 1, 16), new three.MeshLambertMaterial({ color: colour }));
    scene.add(mesh);
    return mesh;
  };
  const ball = (radius, colour) => {
    const mesh = new three.Mesh(new three.SphereGeometry(radius, 20, 14), new three.MeshLambertMaterial({ color: colour }));
    scene.add(mesh);
    return mesh;
  };
  const letter = (text, place, bad) => {
    const canvas = document.createElement("canvas");
    canvas.width = 512;
    canvas.height = 64;
    const draw = canvas.getContext("2d");
    draw.font = "bold 40px system-ui, sans-serif";
    draw.textAlign = "center";
    draw.lineWidth = 8;
    draw.strokeStyle = dark ? "#15181c" : "#ffffff";
    draw.strokeText(text, 256, 48);
    draw.fillStyle = bad ? wrong : ink;
    draw.fillText(text, 256, 48);
    const texture = new three.CanvasTexture(canvas);
    texture.colorSpace = three.SRGBColorSpace;
    const sprite = new three.Sprite(new three.SpriteMaterial({ map: texture, depthTest: false, sizeAttenuation: false }));
    sprite.scale.set(0.28, 0.035, 1);
    sprite.center.set(0.5, -0.25);
    sprite.position.copy(place);
    sprite.renderOrder = 2;
    scene.add(sprite);
    return sprite;
  };
  // A tube of five sides about a polyline, each piece in its colour.
  const tube = (points, radius, colourOf, outline) => {
    const at = [];
    const colours = [];
    const faces = [];
    const colour = new three.Color();
    for (let k = 0; k + 1 < points.length; k += 1) {
      const way = new three.Vector3().subVectors(points[k + 1], points[k]);
      if (way.lengthSq() === 0) continue;
      way.normalize();
      const side = new three.Vector3().crossVectors(way, Math.abs(way.z) < 0.9 ? new three.Vector3(0, 0, 1) : new three.Vector3(1, 0, 0)).normalize();
      const up = new three.Vector3().crossVectors(side, way);
      const [shade, thick] = colourOf(k);
      colour.set(shade);
      const first = at.length / 3;
      for (const end of [points[k], points[k + 1]]) {
        for (let s = 0; s < 5; s += 1) {
          const turn = (s / 5) * 2 * Math.PI;
          const [c, d] = [Math.cos(turn) * radius * thick, Math.sin(turn) * radius * thick];
          at.push(end.x + side.x * c + up.x * d, end.y + side.y * c + up.y * d, end.z + side.z * c + up.z * d);
          colours.push(colour.r, colour.g, colour.b);
        }
      }
      for (let s = 0; s < 5; s += 1) {
        const [a, b] = [first + s, first + ((s + 1) % 5)];
        faces.push(a, b, a + 5, b, b + 5, a + 5);
      }
    }
    const geometry = new three.BufferGeometry();
    geometry.setAttribute("position", new three.Float32BufferAttribute(at, 3));
    geometry.setAttribute("color", new three.Float32BufferAttribute(colours, 3));
    geometry.setIndex(faces);
    // Without depth, and first: it stands out against what is behind, and hides nothing of a path whose loops are close.
    const mesh = new three.Mesh(geometry, outline ? new three.MeshBasicMaterial({ color: ink, side: BACK, depthWrite: false }) : new three.MeshBasicMaterial({ vertexColors: true, side: BOTH }));
    mesh.renderOrder = outline ? -1 : 0;
    scene.add(mesh);
  };
  // A wall between two polylines of as many points.
  const wall = (low, high, colour, opacity) => {
    const at = [];
    const faces = [];
    low.forEach((point, k) => {
      at.push(point.x, point.y, point.z, high[k].x, high[k].y, high[k].z);
      if (k) faces.push(2 * k - 2, 2 * k - 1, 2 * k, 2 * k - 1, 2 * k + 1, 2 * k);
    });
    const geometry = new three.BufferGeometry();
    geometry.setAttribute("position", new three.Float32BufferAttribute(at, 3));
    geometry.setIndex(faces);
    const mesh = new three.Mesh(geometry, new three.MeshBasicMaterial({ color: colour, side: BOTH, transparent: true, opacity, depthWrite: false }));
    mesh.renderOrder = 1;
    scene.add(mesh);
  };

  // From afar the letters of worst places would lie on each other: there one word says where the path is.
  const letters = [];
  let farther = null;
  const all = new three.Box3();
  const near = new three.Box3();
  const place = session.place;
  if (place) {
    const [wrist, tip] = [vectors(place.wrist), vectors(place.tip)];
    const size = new three.Vector3();
    near.setFromPoints(tip.concat(wrist)).getSize(size);
    const radius = Math.max(0.4, size.length() / 260);
    const palette = (shade) => (shade === -1 ? [wrong, 1.7] : shade < 0 ? [soft, 1] : [place.palette[shade], 1]);
    for (const points of [wrist, tip]) {
      tube(points, radius * 1.5, (k) => [ink, palette(place.shade[k])[1]], true);
      tube(points, radius, (k) => palette(place.shade[k]), false);
    }
    const every = Math.max(1, Math.floor(tip.length / 60));
    const axes = [];
    for (let k = 0; k < tip.length; k += every) axes.push(wrist[k], tip[k]);
    scene.add(new three.LineSegments(new three.BufferGeometry().setFromPoints(axes), new three.LineBasicMaterial({ color: soft, transparent: true, opacity: 0.35 })));
    for (const flat of place.workspace) polyline(vectors(flat), ink, false);
    for (const flat of place.deadband) polyline(vectors(flat), soft, true);
    // Each arc of the boundary comes with both ends of the slide and a corner, each of the deadband with both ends.
    for (let k = 0; k + 2 < place.workspace.length; k += 3) wall(vectors(place.workspace[k]), vectors(place.workspace[k + 1]), went, 0.1);
    for (let k = 0; k + 1 < place.deadband.length; k += 2) wall(vectors(place.deadband[k]), vectors(place.deadband[k + 1]), wrong, 0.05);
    for (const flat of place.workspace) all.union(new three.Box3().setFromPoints(vectors(flat)));
    for (const one of place.worst) letters.push(letter(one.letter, vectors(one.place)[0], one.violated));
    farther = letter("path", near.getCenter(new three.Vector3()), place.worst.some((one) => one.violated));
    all.union(near);
  }
  all.expandByPoint(new three.Vector3(0, 0, 0));
  const here = place ? ball(Math.max(1.5, near.getSize(new three.Vector3()).length() / 90), went) : null;
  if (here) here.visible = false;

  let arm = null;
  if (session.arm) {
    const points = vectors(session.arm.points);
    const tips = points.filter((_, k) => k % 4 === 3);
    const way = polyline(tips, went, true);
    way.material.depthTest = false;
    for (const point of points) all.expandByPoint(point);
    const grey = dark ? "#6f7c8d" : "#8a97a8";
    arm = { points, rods: [rod(28, grey), rod(20, grey), rod(16, grey), rod(4, ink)], balls: [ball(30, grey), ball(24, grey), ball(12, grey)] };
    if (!place) near.setFromPoints(tips);
  }

  const draw = () => {
    const away = near.isEmpty() || camera.position.distanceTo(near.getCenter(new three.Vector3())) > 6 * near.getSize(new three.Vector3()).length();
    // Close to the path the arm would stand before it.
    for (const mesh of arm ? [...arm.rods.slice(0, 3), ...arm.balls] : []) {
      mesh.material.transparent = !away;
      mesh.material.opacity = away ? 1 : 0.22;
      mesh.material.depthWrite = away;
    }
    for (const one of letters) one.visible = !away;
    if (farther) farther.visible = away;
    renderer.render(scene, camera);
  };
  const fit = (box, from) => {
    const middle = box.getCenter(new three.Vector3());
    const way = new three.Vector3(...from).normalize();
    let away = Math.max(box.getSize(new three.Vector3()).length(), 10) * 2;
    controls.target.copy(middle);
    // The corner that is farthest out, of the whole width or height, says how much nearer or farther to go.
    for (let round = 0; round < 6; round += 1) {
      camera.position.copy(middle).addScaledVector(way, away);
      controls.update();
      camera.updateMatrixWorld();
      let out = 0;
      for (let corner = 0; corner < 8; corner += 1) {
        const seen = new three.Vector3(corner & 1 ? box.max.x : box.min.x, corner & 2 ? box.max.y : box.min.y, corner & 4 ? box.max.z : box.min.z).project(camera);
        out = Math.max(out, Math.abs(seen.x), Math.abs(seen.y));
      }
      away *= Math.min(Math.max(out / 0.88, 0.5), 2);
    }
    camera.position.copy(middle).addScaledVector(way, away);
    controls.update();
    draw();
  };
  const resize = () => {
    const width = holder.clientWidth || 600;
    const height = Math.round(Math.min(width * 0.75, 520));
    renderer.setSize(width, height);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    draw();
  };
  controls.addEventListener("change", draw);
  resize();
  const whole = () => fit(all, [-0.6, -1, 0.75]);
  const toPath = () => fit(near.isEmpty() ? all : near, [-0.6, -1, 0.55]);
  whole();
  return {
    resize, whole, toPath, draw,
    moment(k) {
      if (!arm) return;
      const [slide, elbow, wrist, tip] = arm.points.slice(4 * k, 4 * k + 4);
      between(arm.rods[0], new three.Vector3(0, 0, Math.min(0, slide.z - 200)), slide);
      between(arm.rods[1], slide, elbow);
      between(arm.rods[2], elbow, wrist);
      between(arm.rods[3], wrist, tip);
      arm.balls[0].position.copy(slide);
      arm.balls[1].position.copy(elbow);
      arm.balls[2].position.copy(wrist);
      draw();
    },
    point(k) {
      if (!here) return;
      here.visible = k !== null;
      if (k !== null) here.position.set(place.wrist[3 * k], place.wrist[3 * k + 1], place.wrist[3 * k + 2]);
      draw();
    },
    // Close to one place of the wrist centre.
    toPlace(x, y, z) {
      const size = Math.max(near.getSize(new three.Vector3()).length() / 6, 5);
      const middle = new three.Vector3(x, y, z);
      fit(new three.Box3(middle.clone().subScalar(size), middle.clone().addScalar(size)), [-0.6, -1, 0.55]);
    },
    dispose() {
      renderer.dispose();
      renderer.forceContextLoss();
    },
  };
}
