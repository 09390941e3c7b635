/** A file that esbuild includes as base64. */
declare module "*.z" {
  const base64: string;
  export default base64;
}
