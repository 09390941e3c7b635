/** A file that esbuild includes as text. */
declare module "*.txt" {
  const text: string;
  export default text;
}
