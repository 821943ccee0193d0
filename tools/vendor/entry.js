// What the report page draws with, by name: the bundler leaves out the rest of both libraries.
export {
  BufferAttribute, BufferGeometry, CanvasTexture, Color, CylinderGeometry, Float32BufferAttribute, Group, HemisphereLight, DirectionalLight,
  Line, LineBasicMaterial, LineDashedMaterial, LineSegments, Mesh, MeshBasicMaterial, MeshLambertMaterial, PerspectiveCamera, Scene,
  SphereGeometry, Sprite, SpriteMaterial, SRGBColorSpace, Vector3, WebGLRenderer, Box3,
} from "three";
export { OrbitControls } from "three/addons/controls/OrbitControls.js";
export { default as uPlot } from "uplot";
