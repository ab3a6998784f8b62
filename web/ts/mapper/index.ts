/** landline/mapper: makes a scene of a film, on the device. */
export { Mapper, packagedMapperWasmUrl } from "./mapper.js";
export { readPoses } from "./poses.js";
export type * from "./types.js";
